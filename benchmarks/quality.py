"""How near to the optimum, how fast, and how often binary: 1,000 random problems of six kinds.

    mixer bench quality --out DIR [--quick]

Three kinds have views, as in the paper's Table I: one modality, four modalities, and one modality
of which more is wrong. Three have none, and are clique partitioning as it is known elsewhere:
relations (Groetschel and Wakabayashi 1989: objects by attributes with missing values, a pair
gains where they agree and loses where they differ), correlations of random data, and cluster
editing on random graphs.

Each problem is solved by Mixer one at a time and in one batch, by its gradient stage alone, and by
Exact, whose bound stands in for the optimum where time ran out. Loop 1 writes rows.csv, one row a
problem; table.md is made from it alone.
"""

import statistics
import time

import numpy as np
import torch
from tqdm import tqdm

import mixer_torch as mx
from mixer_torch.benchmarks import results
from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.solvers.problem import is_distinct

WITH_VIEWS = {
    "one modality": {"noise": 0.3, "wrong": 0.1},
    "four modalities": {"noise": 0.4, "wrong": 0.3, "modalities": 4},
    "one modality, hard": {"noise": 0.5, "wrong": 0.15},
}
SIZES = (50, 100)
REPEATS = 5  # of a batch, of which the median is told
COLUMNS = (
    *("kind", "seed", "m", "feasible", "binary"),
    *("gradient", "mixer", "mixer_in_batch", "exact", "lower_bound", "proven"),
    *("seconds", "seconds_in_batch"),
)


def relations(m, rng):
    """Share of the attributes, of 3 to 8 values each and 10 % missing, in which two agree."""
    table = rng.integers(0, rng.integers(3, 9, 9), (m, 9)).astype(float)
    table[rng.random(table.shape) < 0.1] = np.nan
    known = ~np.isnan(table[:, None]) & ~np.isnan(table)
    agree = (table[:, None] == table) & known
    return 0.5 + (2 * agree.sum(2) - known.sum(2)) / 18


def correlations(m, rng):
    """Correlation of random rows of 12 numbers, from 0 to 1."""
    return (1 + np.corrcoef(rng.standard_normal((m, 12)))) / 2


def cluster_editing(m, rng):
    """A random graph of density 0.3 to 0.5: 1 where there is an edge."""
    upper = np.triu(rng.random((m, m)) < rng.uniform(0.3, 0.5), 1)
    return (upper | upper.T).astype(float)


WITHOUT_VIEWS = {
    "relations": relations,
    "correlations": correlations,
    "cluster editing": cluster_editing,
}


def problems(each, dense, first):
    """(kind, affinity): as many of each kind with views, and of each kind and size without."""
    for kind, settings in WITH_VIEWS.items():
        for seed in range(each):
            views = 2 + seed % 11
            yield kind, synthetic(10, views, 0.4, 0.2, seed=first + seed, **settings)[0]
    for kind, draw in WITHOUT_VIEWS.items():
        for m in SIZES:
            for seed in range(dense):
                scores = draw(m, np.random.default_rng([m, first + seed]))
                view = torch.full((m,), -1)
                yield f"{kind}, m = {m}", mx.Affinity.from_dense(scores, view)


def timed_batch(affinities, solver):
    start = time.perf_counter()
    answers = mx.solve(affinities, solver)
    return answers, time.perf_counter() - start


def rows_of(affinities, kind, time_limit):
    batch, gradient = mx.Mixer(), mx.Mixer(refine=False, schedule="anneal")
    timed = [timed_batch(affinities, batch) for _ in range(REPEATS)]
    together = timed[0][0]
    batch_seconds = statistics.median(seconds for _, seconds in timed) / len(affinities)
    alone = mx.solve(affinities, gradient)
    for seed, affinity in enumerate(affinities):
        start = time.perf_counter()
        answer = mx.solve(affinity)
        seconds = time.perf_counter() - start
        optimum = mx.solve(affinity, mx.Exact(time_limit=time_limit))
        in_view = affinity.view >= 0
        yield {
            "kind": kind,
            "seed": seed,
            "m": len(affinity),
            "feasible": int(is_distinct(answer.labels[in_view], affinity.view[in_view])),
            "binary": int(alone[seed].stats["binary_without_rounding"]),
            "gradient": alone[seed].objective,
            "mixer": answer.objective,
            "mixer_in_batch": together[seed].objective,
            "exact": optimum.objective,
            "lower_bound": optimum.lower_bound,
            "proven": int(optimum.status is mx.Status.OPTIMAL),
            "seconds": seconds,
            "seconds_in_batch": batch_seconds,
        }


def percent_above(row, key, reference):
    return 100 * (row[key] - row[reference]) / max(abs(row[reference]), 1e-12)


def table(rows):
    """Markdown, from the rows alone."""
    lines = [
        f"{len(rows)} problems, {sum(r['feasible'] for r in rows):.0f} answers feasible, gradient "
        f"stage binary without rounding in {sum(r['binary'] for r in rows):.0f}. Gaps to the best "
        "answer of Exact (to its proven bound in brackets), %; times in milliseconds a problem, "
        f"{results.machine()}.",
        "",
        "| kind | problems | m | gap, mean | worst | in a batch, mean | worst | gradient stage, "
        "sums | Exact proved | median ms | ms in a batch |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for (kind,), group in results.grouped(rows, "kind").items():
        single, batch = (
            [percent_above(row, key, "exact") for row in group]
            for key in ("mixer", "mixer_in_batch")
        )
        pooled = {key: sum(row[key] for row in group) for key in ("gradient", "exact")}
        bound = statistics.mean(percent_above(row, "mixer", "lower_bound") for row in group)
        cells = [
            kind,
            len(group),
            f"{results.mean(group, 'm'):.0f}",
            f"{statistics.mean(single):.4f} ({bound:.3f})",
            f"{max(single):.3f}",
            f"{statistics.mean(batch):.4f}",
            f"{max(batch):.3f}",
            f"{percent_above(pooled, 'gradient', 'exact'):.2f}",
            f"{sum(row['proven'] for row in group):.0f}/{len(group)}",
            f"{1e3 * statistics.median(row['seconds'] for row in group):.1f}",
            f"{1e3 * group[0]['seconds_in_batch']:.1f}",
        ]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines) + "\n"


def run(each, dense, first, time_limit):
    for solver in (mx.Mixer(), mx.Mixer(refine=False)):  # kernels are compiled or loaded
        mx.solve(synthetic(4, 3, seed=0)[0], solver)
    groups = {}
    for kind, affinity in problems(each, dense, first):
        groups.setdefault(kind, []).append(affinity)
    for kind, affinities in tqdm(groups.items(), disable=None):
        yield from rows_of(affinities, kind, time_limit)


def main(argv=None):
    arguments = results.arguments(
        (__file__, __doc__),
        argv,
        "20 problems of a kind with views, 2 of a kind and size without",
        first=(90_000, "seed of the first problem of each kind"),
        time_limit=(20, "of Exact, seconds"),
    )
    if not arguments.from_rows:
        counts = (20, 2) if arguments.quick else (312, 11)
        rows = run(*counts, arguments.first, arguments.time_limit)
        results.write(arguments.out / "rows.csv", COLUMNS, rows)
    return results.tabled(arguments.out, table)


if __name__ == "__main__":
    print(main())
