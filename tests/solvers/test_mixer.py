"""MIXER against brute force, at the edges, and what its statistics say."""

import math
import time

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import mixer_torch as mx
from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.solvers.gradient.graduated_non_convexity import GraduatedNonConvexity
from mixer_torch.solvers.gradient.penalty_doubling import PenaltyDoubling
from mixer_torch.solvers.mixer import Mixer
from mixer_torch.solvers.problem import Problem, is_distinct, objective_of, problem_of

PURE = {"refine": False}
SETTINGS = [
    {},
    {"restarts": 0},
    PURE,
    PURE | {"projection": "simplex"},
    PURE | {"schedule": "anneal"},
    {"schedule": "penalty"},
]


def make(m, pairs, cost, view=None, dtype=torch.float32):
    view = torch.arange(m) if view is None else torch.as_tensor(view)
    cost = torch.as_tensor(cost, dtype=dtype)
    return Problem(torch.as_tensor(pairs).reshape(2, -1), cost, view, torch.full_like(cost, 0.5))


def random_problem(seed, m, views, dtype=torch.float32, scale=1.0):
    generator = torch.Generator().manual_seed(seed)
    view = torch.randint(0, views, (m,), generator=generator)
    pairs = torch.triu_indices(m, m, offset=1)
    pairs = pairs[:, view[pairs[0]] != view[pairs[1]]]
    cost = scale * torch.randn(pairs.shape[1], generator=generator, dtype=dtype)
    return make(m, pairs, cost, view, dtype)


def partitions(m):
    """All partitions of m things, as labels by first appearance."""
    if m == 0:
        yield []
        return
    for shorter in partitions(m - 1):
        for label in range(max(shorter, default=-1) + 2):
            yield [*shorter, label]


def optimum(problem):
    """The least objective of all feasible partitions."""
    labels = torch.tensor(list(partitions(len(problem))))
    a, b = problem.pairs
    together = (labels[:, a] == labels[:, b]).double()
    apart = problem.conflicts().triu().nonzero().T
    feasible = ~(labels[:, apart[0]] == labels[:, apart[1]]).any(1)
    return float((together @ problem.cost.double())[feasible].min())


def check(problem, solution):
    labels = solution.labels
    assert labels.shape == problem.view.shape
    assert labels.dtype == torch.int64
    assert is_distinct(labels, problem.view)
    assert all(math.isfinite(value) for value in solution.stats["history"])
    assert solution.stats["binary_without_rounding"] in (True, False)
    if solution.status is mx.Status.CONVERGED:
        assert solution.stats["binary_without_rounding"]


@pytest.mark.parametrize("views", [1, 3, 8, 50])
def test_against_brute_force(views):
    for seed in range(10):
        problem = random_problem(seed, m=4 + seed % 4, views=views)
        best = optimum(problem)
        solution = Mixer().run(problem)
        check(problem, solution)
        assert objective_of(problem, solution.labels) == pytest.approx(best, abs=1e-5)


@pytest.mark.parametrize("projection", ["row_sum_at_most_one", "simplex"])
def test_the_algorithm_of_the_paper_is_near_the_optimum(projection):
    gaps, binary = [], []
    for seed in range(40):
        problem = problem_of(synthetic(objects=3, views=3, seed=seed)[0])
        if not 4 <= len(problem) <= 8:
            continue
        solution = Mixer(refine=False, projection=projection).run(problem)
        check(problem, solution)
        best = optimum(problem)
        gaps.append((objective_of(problem, solution.labels) - best) / max(abs(best), 1e-9))
        binary.append(solution.stats["binary_without_rounding"])
    assert len(gaps) > 15
    assert min(gaps) > -1e-5
    assert sum(gaps) / len(gaps) < 0.05
    assert all(binary)


@pytest.mark.parametrize("arguments", SETTINGS)
def test_list_of_problems_of_all_sizes(arguments):
    problems = [random_problem(m, m, views=4) for m in (1, 2, 3, 17, 40)]
    problems += [random_problem(m, m, views=99, dtype=torch.float64) for m in (1, 5, 30)]
    solver = Mixer(**arguments)
    for problem, solution in zip(problems, solver.run_batch(problems), strict=True):
        check(problem, solution)
        alone = objective_of(problem, solver.run(problem).labels)
        assert objective_of(problem, solution.labels) == pytest.approx(alone, rel=0.3, abs=0.5)


@pytest.mark.parametrize("schedule", ["anneal", "penalty"])
def test_binary_without_rounding(schedule):
    affinities = [
        synthetic(views=2 + seed % 6, modalities=1 + seed % 4, noise=0.1 * (seed % 5), seed=seed)[0]
        for seed in range(100)
    ]
    solver = Mixer(refine=False, schedule=schedule)
    solutions = solver.run_batch([problem_of(affinity) for affinity in affinities])
    assert sum(s.stats["binary_without_rounding"] for s in solutions) >= 99


def test_annealing_beats_the_schedule_of_the_paper_and_refinement_both():
    problems = [problem_of(synthetic(views=6, noise=0.4, seed=seed)[0]) for seed in range(20)]
    total = {
        name: sum(
            objective_of(problem, solution.labels)
            for problem, solution in zip(problems, solver.run_batch(problems), strict=True)
        )
        for name, solver in {
            "paper": Mixer(refine=False),
            "annealed": Mixer(refine=False, schedule="anneal"),
            "refined": Mixer(restarts=20),
        }.items()
    }
    assert total["refined"] < total["annealed"] < total["paper"] < 0


def test_never_worse_than_either_start():
    problems = [random_problem(seed, 30, views=6) for seed in range(8)]
    for restarts in (0, 5):
        for problem, solution in zip(
            problems, Mixer(restarts=restarts).run_batch(problems), strict=True
        ):
            stats = solution.stats
            final = objective_of(problem, solution.labels)
            assert final == pytest.approx(stats["objective_refined"], rel=1e-5)
            assert final <= stats["objective_greedy"] + 1e-4
            assert final <= stats["objective_gradient"] + 1e-4
            assert stats["history"][-1] == stats["objective_refined"]
            start = min(stats["objective_greedy"], stats["objective_gradient"])
            gained = sum(stats["gained"].values())
            assert start - gained == pytest.approx(stats["objective_refined"], abs=1e-6)
            assert (stats["restarts"] > 0) == (restarts > 0)


def test_the_history_ends_at_the_objective_of_the_gradient_stage():
    problem = random_problem(0, 25, views=5, dtype=torch.float64)
    for solver in (Mixer(refine=False, schedule="anneal"), Mixer(refine=False)):
        solution = solver.run(problem)
        history, objective = solution.stats["history"], objective_of(problem, solution.labels)
        if isinstance(
            solver.gradient.schedule, PenaltyDoubling
        ):  # F_d at a solution: less m d, in the cost's unit
            scale = float(problem.cost.abs().max())
            objective -= 0.5 * len(problem) * solution.stats["penalty"] * scale
        assert len(history) == solution.stats["iterations"]
        assert history[-1] == pytest.approx(objective, rel=1e-2)


@pytest.mark.parametrize("arguments", SETTINGS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_edges(arguments, dtype):
    m = 12
    pairs = torch.triu_indices(m, m, offset=1)
    count = pairs.shape[1]
    half = torch.arange(count) % 2 * 2.0 - 1
    components = (pairs[0] < 6) == (pairs[1] < 6)
    same_twin = torch.where(pairs[0] // 2 == pairs[1] // 2, -1.0, 0.5)
    cases = [
        make(m, pairs, 1e6 * half, dtype=dtype),
        make(m, pairs, -1e6 * torch.ones(count), dtype=dtype),
        make(m, pairs, 1e-20 * half, dtype=dtype),
        make(m, pairs, -torch.ones(count), dtype=dtype),
        make(m, pairs, torch.zeros(count), dtype=dtype),
        make(m, pairs, torch.ones(count), dtype=dtype),
        make(m, pairs, half, dtype=dtype),
        make(m, pairs, same_twin, dtype=dtype),
        make(m, pairs[:, components], -torch.ones(int(components.sum())), dtype=dtype),
        make(m, torch.zeros(2, 0, dtype=torch.int64), torch.zeros(0), dtype=dtype),
        make(m, torch.zeros(2, 0, dtype=torch.int64), torch.zeros(0), [0] * m, dtype=dtype),
        random_problem(0, m, 3, dtype, scale=1e6),
    ]
    solver = Mixer(**arguments)
    for problem in cases:
        solution = solver.run(problem)
        check(problem, solution)
        if solver.refine:
            assert objective_of(problem, solution.labels) <= 0
        assert torch.equal(solver.run(problem).labels, solution.labels)


@settings(max_examples=30, deadline=None)
@given(
    st.integers(1, 14),
    st.integers(1, 14),
    st.lists(st.sampled_from([-1e6, -1.0, -0.5, 0.0, 0.5, 1.0, 1e6]), min_size=91, max_size=91),
    st.sampled_from(SETTINGS),
)
def test_fuzz(m, views, values, arguments):
    view = torch.arange(m) % views
    pairs = torch.triu_indices(m, m, offset=1)
    pairs = pairs[:, view[pairs[0]] != view[pairs[1]]]
    problem = make(m, pairs, values[: pairs.shape[1]], view)
    solution = Mixer(**arguments).run(problem)
    check(problem, solution)
    if arguments.get("refine", True):
        assert objective_of(problem, solution.labels) <= 0


def test_what_forbids_sets_of_views_is_kept():
    for seed in range(5):
        affinity, _ = synthetic(objects=4, views=4, seed=seed)
        m = len(affinity)
        cannot = torch.tensor([[0, 1, 2], [m - 1, m - 2, m - 3]])
        for arguments in SETTINGS:
            association = mx.solve(affinity, Mixer(**arguments), cannot_link=cannot)
            labels = association.labels
            assert bool((labels[cannot[0]] != labels[cannot[1]]).all())


def test_out_of_iterations_is_rounded_and_said():
    problem = problem_of(synthetic(views=6, noise=0.4, seed=0)[0])
    for schedule in ("anneal", "penalty"):
        solution = Mixer(max_iterations=2, refine=False, schedule=schedule).run(problem)
        check(problem, solution)
        assert solution.status is mx.Status.ROUNDED
        assert not solution.stats["binary_without_rounding"]
        assert solution.stats["iterations"] == 2
    assert Mixer(max_iterations=2).run(problem).status is mx.Status.ROUNDED


def test_out_of_time():
    problems = [random_problem(seed, 60, views=9) for seed in range(3)]
    for arguments in ({"restarts": 10**9}, {"refine": False}):
        begin = time.perf_counter()
        limit = 0.5 if "restarts" in arguments else 1e-9
        solutions = Mixer(time_limit=limit, **arguments).run_batch(problems)
        assert time.perf_counter() - begin < 20
        for problem, solution in zip(problems, solutions, strict=True):
            assert solution.status is mx.Status.TIME_LIMIT
            assert is_distinct(solution.labels, problem.view)


@pytest.mark.parametrize("arguments", SETTINGS)
def test_progress_rises_to_one(arguments):
    told = []
    problems = [random_problem(seed, 10 + 10 * seed, views=9) for seed in range(3)]
    Mixer(progress=told.append, **arguments).run_batch(problems)
    assert told == sorted(told)
    assert told[-1] == pytest.approx(1)


def test_bfloat16_is_a_choice():
    problem = problem_of(synthetic(views=5, seed=0)[0])
    plain = Mixer(refine=False, schedule="anneal").run(problem)
    for precision in ("bfloat16", "tf32"):
        before = torch.backends.cuda.matmul.allow_tf32
        solution = Mixer(refine=False, schedule="anneal", precision=precision).run(problem)
        check(problem, solution)
        assert torch.backends.cuda.matmul.allow_tf32 == before
        rough, fine = (objective_of(problem, s.labels) for s in (solution, plain))
        assert rough < 0.9 * fine


def test_the_paper_and_schedules_by_name_are_what_the_objects_say():
    problems = [random_problem(seed, 20, views=5) for seed in range(3)]
    same = [
        (Mixer.paper(seed=3), Mixer(refine=False, seed=3)),
        (Mixer.paper(projection="simplex"), Mixer(refine=False, projection="simplex")),
        (Mixer(schedule=PenaltyDoubling("simplex"), restarts=2),
         Mixer(schedule="penalty", projection="simplex", restarts=2)),
        (Mixer(schedule=GraduatedNonConvexity(precision="bfloat16")),
         Mixer(precision="bfloat16")),
    ]  # fmt: skip
    for one, other in same:
        assert one.gradient == other.gradient
        for a, b in zip(one.run_batch(problems), other.run_batch(problems), strict=True):
            assert torch.equal(a.labels, b.labels)
    short = Mixer(refine=False, schedule=GraduatedNonConvexity(iterations=30), max_iterations=30)
    assert short.run(problems[0]).stats["iterations"] == 30
    with pytest.raises(ValueError, match="iterations: expected"):
        GraduatedNonConvexity(iterations=0)


def test_random_numbers_of_others_are_left_alone():
    before = torch.random.get_rng_state()
    Mixer().run(random_problem(0, 20, views=4))
    assert torch.equal(before, torch.random.get_rng_state())


@pytest.mark.parametrize(
    "arguments",
    [
        {"max_iterations": 0},
        {"schedule": "fast"},
        {"projection": "ball"},
        {"precision": "float8"},
        {"restarts": -1},
        {"time_limit": 0.0},
        {"time_limit": float("nan")},
    ],
)
def test_arguments_out_of_range(arguments):
    with pytest.raises(ValueError, match=f"^{next(iter(arguments))}: expected"):
        Mixer(**arguments)


@pytest.mark.cuda
def test_the_gradient_stage_runs_where_the_scores_are():
    affinities = [synthetic(views=5, seed=seed, device="cuda")[0] for seed in range(8)]
    for arguments in SETTINGS:
        first = mx.solve(affinities, Mixer(**arguments))
        second = mx.solve(affinities, Mixer(**arguments))
        for one, other in zip(first, second, strict=True):
            assert one.labels.device.type == "cuda"
            assert torch.equal(one.labels, other.labels)
