"""What half and twice of each number in the solvers do to answer and time.

    mixer bench sensitivity --out DIR [--quick]

The numbers of the search, of the multilevel refinement, of dual ascent and of branch and cut were
set by hand. Each is halved and doubled, one at a time, for the same random problems: those of
quality.py are refined from greedy contraction, bounded and proven; sparse ones of a few thousand
nodes go through the multilevel refinement. Times are those of the process, so that other load
counts little. Loop 1 writes rows.csv, one row a problem and value; table.md is made from it alone.
"""

import time
from contextlib import ExitStack
from unittest import mock

import numpy as np
from tqdm import tqdm

import mixer_torch as mx
from mixer_torch.benchmarks import quality, results
from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.solvers.bounds import lower_bound
from mixer_torch.solvers.local_search import LocalSearch
from mixer_torch.solvers.problem import problem_of
from mixer_torch.solvers.proof import branching, dual_ascent
from mixer_torch.solvers.refinement import refine
from mixer_torch.solvers.search import iterated_local_search, multilevel, subproblem
from mixer_torch.solvers.search.graph import Graph
from mixer_torch.solvers.search.greedy import greedy

COLUMNS = ("stage", "name", "value", "factor", "problem", "answer", "seconds")
FACTORS = (1.0, 0.5, 2.0)
ASCENT = ("SOFTEST", "HARDEST", "SWEEPS", "ROUNDS", "LEAST_GAIN", "SMALL", "VIOLATION", "STARTS")
BRANCHING = ("ROUNDS", "WORTH", "ASCENT")


def refined(affinity):
    graph = Graph.from_problem(problem_of(affinity))
    return refine(graph, greedy(graph), seed=1)[1]["objective"]


def refined_in_subproblems(affinity):
    graph = Graph.from_problem(problem_of(affinity))
    random = np.array([1], np.uint64)
    return graph.objective(multilevel.refine_large(graph, greedy(graph), 10, random, np.inf)[0])


def bounded(affinity):
    return lower_bound(affinity, time_limit=60.0)


def proven(affinity):
    exact = mx.Exact(time_limit=60.0, start=LocalSearch(seed=1))
    return mx.solve(affinity, exact).lower_bound


def settings_with(name, value):
    """Patches that put one number of the search into both places that read it."""
    settings = iterated_local_search.SETTINGS._replace(**{name: value})
    return [mock.patch.object(m, "SETTINGS", settings) for m in (iterated_local_search, subproblem)]


def constant_of(module):
    return lambda name, value: [mock.patch.object(module, name, value)]


def stages(each, dense, first):
    """(stage, what is measured, problems, numbers by name, patches) of each kind of number."""
    small = [affinity for _, affinity in quality.problems(each, dense, first)]
    large = [
        synthetic(400, 8, 0.5, 0.3, noise=0.4, wrong=0.02, inconclusive=0.9, seed=first + seed)[0]
        for seed in range(dense)
    ]
    numbers = iterated_local_search.SETTINGS._asdict()
    yield "search", refined, small, numbers, settings_with
    medium = [affinity for affinity in small if len(affinity) <= quality.SIZES[0]]
    for stage, measured, chosen, module, names in (
        ("multilevel", refined_in_subproblems, large, multilevel, ("SUBPROBLEM", "SWEEPS")),
        ("dual ascent", bounded, medium[:: max(1, each // 2)], dual_ascent, ASCENT),
        ("branch and cut", proven, medium[:: max(1, each // 2)], branching, BRANCHING),
    ):
        values = {name: getattr(module, name) for name in names}
        yield stage, measured, chosen, values, constant_of(module)


def run(each, dense, first):
    for stage, measured, affinities, numbers, patches in stages(each, dense, first):
        measured(affinities[0])  # kernels are compiled or loaded
        for name, number in tqdm(numbers.items(), stage, disable=None):
            for factor in FACTORS if name == next(iter(numbers)) else FACTORS[1:]:
                value = type(number)(max(number * factor, 1) if number >= 1 else number * factor)
                key = (stage, "as set" if factor == 1 else name, value, factor)
                with ExitStack() as patched:
                    for patch in patches(name, value):
                        patched.enter_context(patch)
                    for i, affinity in enumerate(affinities):
                        start = time.process_time()
                        answer = measured(affinity)
                        values = (*key, i, answer, time.process_time() - start)
                        yield dict(zip(COLUMNS, values, strict=True))


def table(rows):
    """Markdown, from the rows alone."""
    lines = [
        "Change of the sum of all answers (objectives; of dual ascent and branch and cut, bounds) "
        f"in %, and time, as multiples of those with the numbers as they are; {results.machine()}.",
        "",
        "| stage | number | half: answer | time | twice: answer | time |",
        "|---|---|---|---|---|---|",
    ]
    sums = {
        key: tuple(sum(row[column] for row in group) for column in ("answer", "seconds"))
        for key, group in results.grouped(rows, "stage", "name", "factor").items()
    }
    for stage, name in results.grouped(rows, "stage", "name"):
        if name == "as set":
            continue
        answer, seconds = sums[stage, "as set", 1.0]
        cells = [stage, name]
        for factor in FACTORS[1:]:
            found, took = sums[stage, name, factor]
            cells += [f"{100 * (found - answer) / abs(answer):+.4f}", f"{took / seconds:.2f}"]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main(argv=None):
    arguments = results.arguments(
        (__file__, __doc__),
        argv,
        "2 problems of a kind with views, 1 of a kind and size without",
        first=(500_000, "seed of the first problem of each kind"),
    )
    if not arguments.from_rows:
        counts = (2, 1) if arguments.quick else (40, 4)
        results.write(arguments.out / "rows.csv", COLUMNS, run(*counts, arguments.first))
    return results.tabled(arguments.out, table)


if __name__ == "__main__":
    print(main())
