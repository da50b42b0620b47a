"""Permutation synchronisation against the closed form and the original rounding."""

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

import mixer_torch as mx
from mixer_torch.solvers.spectral import Spectral, embedding
from mixer_torch.solvers.synchronization import greedy_rounding


def permutations_with_errors(seed, n, views, wrong):
    """Full permutations between views, a share of them replaced by random ones."""
    generator = np.random.default_rng(seed)
    order = np.stack([generator.permutation(n) for _ in range(views)])
    full = np.eye(n * views)
    for i in range(views):
        for j in range(i + 1, views):
            block = order[i][:, None] == order[j]
            if generator.random() < wrong:
                block = np.eye(n)[generator.permutation(n)]
            full[i * n : (i + 1) * n, j * n : (j + 1) * n] = block
            full[j * n : (j + 1) * n, i * n : (i + 1) * n] = block.T
    return full, order.ravel(), np.repeat(np.arange(views), n)


def original_rounding(full, n, views):
    """Pachauri et al.: V V_1ᵀ, by linear assignment in each view."""
    vectors = np.linalg.eigh(full)[1][:, -n:]
    labels = []
    for i in range(views):
        gain = vectors[i * n : (i + 1) * n] @ vectors[:n].T
        labels.append(linear_sum_assignment(gain, maximize=True)[1])
    return np.concatenate(labels)


def test_agrees_with_the_original_on_full_permutations():
    for seed in range(5):
        full, identity, view = permutations_with_errors(seed, n=6, views=12, wrong=0.4)
        answer = mx.solve(mx.Affinity.from_dense(full, view), Spectral(universe=6)).labels.numpy()
        original = original_rounding(full, 6, 12)
        same = answer[:, None] == answer
        assert np.array_equal(same, original[:, None] == original)
        assert np.array_equal(same, identity[:, None] == identity)


def test_correlations_of_noiseless_matches_are_the_matches():
    identity = torch.tensor([0, 1, 0, 2, 1, 0])
    same = (identity[:, None] == identity).double()
    rows = embedding(same - torch.eye(6, dtype=torch.float64), 3)
    torch.testing.assert_close(rows @ rows.T, same)


def test_rounding_takes_the_best_of_each_view():
    correlation = torch.tensor(
        [
            [1.0, 0.6, 0.9, 0.3],
            [0.6, 1.0, 0.0, 0.8],
            [0.9, 0.0, 1.0, 0.0],
            [0.3, 0.8, 0.0, 1.0],
        ]
    )
    view = torch.tensor([0, 1, 1, 2])
    # 0 takes 2 rather than 1 from view 1, and nothing above 0.5 from view 2; 1 takes 3.
    labels = greedy_rounding(correlation, view)
    assert labels.tolist() == [0, 1, 0, 1]


def test_rounding_starts_with_the_first_view_whatever_the_order():
    correlation = torch.tensor([[1.0, 0.7, 0.6], [0.7, 1.0, 0.6], [0.6, 0.6, 1.0]])
    view = torch.tensor([1, 1, 0])  # the last observation is in the first view, and takes its best
    assert greedy_rounding(correlation, view).tolist() in ([2, 1, 2], [0, 1, 0])
