"""Networks: parts that add up, against autograd's own layers, and files."""

import numpy as np
import pytest
import torch

from mixer_torch.tracking.training import fit
from mixer_torch.tracking.weights import FORMAT, NETWORKS, Network, Weights, masks

MODALITY = ("a", "a", "b", "context")


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(3000, 4))
    odds = 2 * x[:, 0] - 1.5 * x[:, 2] + np.abs(x[:, 1]) - 1
    return x, (rng.random(3000) < 1 / (1 + np.exp(-odds))).astype(float), odds


@pytest.fixture(scope="module")
def network(data):
    x, same, _ = data
    return fit(x, same, np.ones(len(x)), tuple("pqrs"), MODALITY, units=4, epochs=300)


def test_a_fit_is_calibrated(data, network):
    x, same, odds = data
    found = network(x)
    assert np.corrcoef(found, odds)[0, 1] > 0.95
    for low, high in ((-3, -1), (-1, 1), (1, 3)):
        inside = (found > low) & (found < high)
        expected = (1 / (1 + np.exp(-found[inside]))).mean()
        assert same[inside].mean() == pytest.approx(expected, abs=0.06)


def test_what_modalities_say_adds_up(data, network):
    x, *_ = data
    parts = network.parts(x)
    assert set(parts) == {"a", "b", "context"}
    assert sum(parts.values()) == pytest.approx(network(x))


def test_a_modality_does_not_see_the_features_of_another(data, network):
    x, *_ = data
    changed = x.copy()
    changed[:, 2] += 1
    before, after = network.parts(x), network.parts(changed)
    assert after["a"] == pytest.approx(before["a"])
    assert not np.allclose(after["b"], before["b"])


def test_it_is_the_network_of_its_formula(data, network):
    z = torch.from_numpy(np.clip((data[0] - network.mean) / network.scale, -4, 4))
    hidden = torch.relu(
        z @ torch.from_numpy(network.hidden) + torch.from_numpy(network.hidden_bias)
    )
    out = hidden @ torch.from_numpy(network.out) + z @ torch.from_numpy(network.linear)
    assert network(data[0]) == pytest.approx((out + network.bias).numpy())


def test_masks():
    owner, sees = masks(MODALITY, 2)
    assert owner == ("a", "a", "b", "b")
    assert sees.tolist() == [[1, 1, 0, 0], [1, 1, 0, 0], [0, 0, 1, 1], [1, 1, 1, 1]]


def test_weights_come_back_from_their_file(data, network, tmp_path):
    path = tmp_path / "own.safetensors"
    Weights({"evidence": network}, {"trained on": "nothing"}).save(path)
    found = Weights.load(path)
    assert found.card == {"trained on": "nothing"}
    assert found["evidence"](data[0]) == pytest.approx(network(data[0]), abs=1e-4)
    assert found["evidence"].modality == MODALITY


def test_files_that_are_no_weights_are_told(tmp_path):
    with pytest.raises(FileNotFoundError, match="absent"):
        Weights.load(tmp_path / "absent.safetensors")
    (tmp_path / "text.safetensors").write_text("text")
    with pytest.raises(ValueError, match="no safetensors file"):
        Weights.load(tmp_path / "text.safetensors")
    from safetensors.numpy import save_file

    save_file({"x": np.zeros(2)}, str(tmp_path / "other.safetensors"))
    with pytest.raises(ValueError, match=FORMAT):
        Weights.load(tmp_path / "other.safetensors")


def test_what_is_shipped_is_small_and_says_what_it_was_learned_on():
    shipped = Weights.shipped()
    assert set(NETWORKS) == set(shipped.networks)
    assert all(isinstance(network, Network) for network in shipped.networks.values())
    assert {"families", "licences"} <= set(shipped.card)
