"""Who is who across two cameras: MIXER against nearest neighbours on the ground, on campus.yaml.

One frame a second, at several starts; 182 seconds are solved at once. A pair is of two detections,
one in each camera, and the readings differ in which pairs count:

- same frame or any frame: of the two detections;
- shared: detections whose true identity both cameras detect in that frame; or all, where a link to
  clutter is wrong, and so is one to a person whom the truth leaves out.

The last reading is of all pairs, within a camera too. Settings are chosen on the first third of the
time: for the baselines, each reading has the setting that is best there for that reading; MIXER has
campus.yaml throughout. Rows go to rows.csv, facts about the data to facts.csv; the table is made
from them.

    mixer bench campus --out out/benchmarks/campus
"""

from importlib import resources
from itertools import product

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from tqdm import tqdm

import mixer_torch as mx
from mixer_torch.benchmarks import results
from mixer_torch.cli import build_parsers
from mixer_torch.metrics.clustering import singletons_for_clutter
from mixer_torch.scorers import Proximity

COLUMNS = ("method", "setting", "part", "start", "reading", "correct", "declared", "true")
FACTS = ("fact", "start", "value")
READINGS = {
    "same frame, shared": {"same_frame": True, "shared": True},
    "same frame, all": {"same_frame": True},
    "any frame, shared": {"shared": True},
    "any frame, all": {},
    "all pairs": {"across": False},
}
PARTS = ("first third", "rest", "whole")
STEP = 30
FIRST_THIRD = 1819  # last frame of it
GATES = (0.5, 0.75, 1.0, 1.5, 2.5)
REACHES = (0.5, 1.0, 1.5)
SPEEDS = (0.5, 1.0, 1.5)


def configured(*overrides):
    """Dataset, scorers and pairs of campus.yaml."""
    parser = build_parsers()[1]["associate"]
    path = resources.files("mixer_torch.configs") / "campus.yaml"
    return parser.instantiate(parser.parse_args([f"--config={path}", "--out=.", *overrides]))


def arrays(observations, *names):
    return [observations[name].numpy() for name in names]


def shared(observations):
    """Which detections are of someone whom both cameras detect in that frame."""
    columns = (x.tolist() for x in arrays(observations, "camera", "frame", "identity"))
    seen = list(zip(*columns, strict=True))
    known = set(seen)
    return np.array([i >= 0 and (1 - c, f, i) in known for c, f, i in seen], dtype=bool)


def counts(observations, labels, keep, same_frame=False, across=True):
    """Correct, declared and true pairs among the observations to keep."""
    camera, frame = (x[keep] for x in arrays(observations, "camera", "frame"))
    truth = singletons_for_clutter(observations["identity"]).numpy()[keep]
    labels, other = np.asarray(labels)[keep], camera[:, None] != camera
    together = frame[:, None] == frame
    counted = np.triu(other if across else other | ~together, 1)
    if same_frame:
        counted &= together
    declared, true = (counted & (x[:, None] == x) for x in (labels, truth))
    return {"correct": (declared & true).sum(), "declared": declared.sum(), "true": true.sum()}


def nearest(distance, gate):
    """Pairs of rows and columns that are nearest to each other, within a gate."""
    if not distance.size:
        return np.empty((2, 0), dtype=np.int64)
    row, column = np.arange(len(distance)), distance.argmin(1)
    keep = (distance.argmin(0)[column] == row) & (distance[row, column] < gate)
    return np.stack([row[keep], column[keep]])


def assigned(distance, gate):
    """The assignment of least total distance, distances beyond a gate counting as the gate."""
    row, column = linear_sum_assignment(np.minimum(distance, gate))
    keep = distance[row, column] < gate
    return np.stack([row[keep], column[keep]])


def linked(observations, gate, rule=nearest, reach=None):
    """Clusters of what is linked frame by frame: between the cameras, and if there is a reach also
    in each camera from one second to the next, where velocity says that it would be.
    """
    camera, frame, place = arrays(observations, "camera", "frame", "position")
    velocity = np.nan_to_num(observations["velocity"].numpy()) * STEP / 29.97
    links = []
    for k in np.unique(frame):
        here = [np.flatnonzero((frame == k) & (camera == c)) for c in (0, 1)]
        jobs = [(here[0], here[1], 0 * velocity, gate, rule)]
        if reach is not None:
            after = [np.flatnonzero((frame == k + STEP) & (camera == c)) for c in (0, 1)]
            jobs += [(a, b, velocity, reach, nearest) for a, b in zip(here, after, strict=True)]
        for a, b, moved, limit, choose in jobs:
            ahead, back = place[a] + moved[a] / 2, place[b] - moved[b] / 2
            row, column = choose(np.linalg.norm(ahead[:, None] - back, axis=2), limit)
            links.append(np.stack([a[row], b[column]]))
    a, b = np.concatenate(links, 1)
    graph = coo_array((np.ones(len(a)), (a, b)), shape=(len(frame), len(frame)))
    return connected_components(graph, directed=False)[1]


def solved(observations, scorers, pairs):
    return mx.associate(observations, scorers, pairs=pairs).labels.numpy()


def answers(observations, chosen, still):
    """(method, setting, labels) of all methods; ``still`` reads the same without velocities."""
    for gate in GATES:
        yield "nearest neighbour", gate, linked(observations, gate)
        yield "Hungarian", gate, linked(observations, gate, assigned)
    for gate, reach in product(GATES, REACHES):
        name = "nearest neighbour, chained"
        yield name, f"{gate}/{reach}", linked(observations, gate, reach=reach)
    without = still.dataset.load()
    for speed in SPEEDS:
        scorer = Proximity(scale=0.4, speed=speed, memory=3)
        yield "MIXER, no velocity", speed, solved(without, [scorer], still.pairs)
    yield "MIXER", "", solved(observations, chosen.scorers, chosen.pairs)


def parts(observations):
    first = observations["frame"].numpy() <= FIRST_THIRD
    return zip(PARTS, (first, ~first, np.ones_like(first)), strict=True)


def run(starts):
    rows, found = [], []
    for start in tqdm(starts, "starts", disable=None):
        begin = f"--dataset.start={start}"
        chosen, still = configured(begin), configured(begin, "--dataset.window=0")
        observations = chosen.dataset.load()
        both = shared(observations)
        found += [{"start": start, **fact} for fact in facts(observations, both)]
        for method, setting, labels in answers(observations, chosen, still):
            for (part, keep), (reading, how) in product(parts(observations), READINGS.items()):
                choice = {key: value for key, value in how.items() if key != "shared"}
                chosen_rows = keep & both if "shared" in how else keep
                row = {"method": method, "setting": setting, "part": part, "start": start}
                row |= {"reading": reading, **counts(observations, labels, chosen_rows, **choice)}
                rows.append(row)
    return rows, found


def facts(observations, both):
    """How much is seen, and how far apart the two cameras see one person, in one frame."""
    identity, camera, frame = arrays(observations, "identity", "camera", "frame")
    for c in (0, 1):
        yield {"fact": f"detections of camera {c}", "value": (camera == c).sum()}
        clutter = ((camera == c) & (identity < 0)).sum()
        yield {"fact": f"detections of camera {c} without identity", "value": clutter}
    yield {"fact": "people detected by both cameras in one frame", "value": both.sum() // 2}
    yield {"fact": "median distance of their two places, m", "value": _distance(observations, both)}
    start = f"--dataset.start={frame.min()}"
    options = (start, "--dataset.depth=0", "--dataset.window=0")
    plain = configured(*options).dataset.load()
    value = _distance(plain, shared(plain))
    yield {"fact": "the same without depth and window, m", "value": value}
    true = configured(*options, "--dataset.source=gt").dataset.load()
    value = _distance(true, shared(true))
    yield {"fact": "the same of true boxes, m", "value": value}
    identity, camera = (x[observations["identity"] >= 0] for x in (identity, camera))
    for c in (0, 1):
        recall = (camera == c).sum() / max(int((true["camera"] == c).sum()), 1)
        yield {"fact": f"recall of camera {c}", "value": recall}


def _distance(observations, both):
    identity, camera, frame, place = (
        x[both] for x in arrays(observations, "identity", "camera", "frame", "position")
    )
    a, b = (
        place[camera == c][np.lexsort((identity[camera == c], frame[camera == c]))] for c in (0, 1)
    )
    return float(np.median(np.linalg.norm(a - b, axis=1)))


def f1(rows):
    correct, declared, true = (
        sum(row[key] for row in rows) for key in ("correct", "declared", "true")
    )
    return 2 * correct / (declared + true) if declared + true else 1.0


def make(out):
    """Tables of F1 over all starts together, from the rows in a folder; the Markdown comes back."""
    rows = results.read(out / "rows.csv")
    starts = len({row["start"] for row in rows})
    lines = [f"F1 over the pairs of {starts} starts together; settings from the first third.", ""]
    for part in PARTS:
        lines += [f"| {part} | " + " | ".join(READINGS) + " |", "|---" * (len(READINGS) + 1) + "|"]
        for (method,), mine in results.grouped(rows, "method").items():
            cells = [_cell(mine, part, reading) for reading in READINGS]
            lines.append(f"| {method} | " + " | ".join(cells) + " |")
        lines.append("")
    lines += ["| mean over the starts | |", "|---|---|"]
    for (fact,), group in results.grouped(results.read(out / "facts.csv"), "fact").items():
        lines.append(f"| {fact} | {results.mean(group, 'value'):.3g} |")
    text = "\n".join(lines) + "\n"
    (out / "table.md").write_text(text)
    return text


def _cell(rows, part, reading):
    """F1 with the setting that is best on the first third, and that setting."""
    settings = results.grouped([r for r in rows if r["reading"] == reading], "setting")

    def on(setting, where):
        return f1([row for row in settings[setting] if row["part"] == where])

    best = max(settings, key=lambda setting: on(setting, PARTS[0]))
    return f"{on(best, part):.3f}" + (f" ({best[0]})" if len(settings) > 1 else "")


def main(argv=None):
    arguments = results.arguments(
        (__file__, __doc__), argv, "one start", starts=(5, "how many starts within the second")
    )
    if not arguments.from_rows:
        torch.set_num_threads(1)
        count = 1 if arguments.quick else arguments.starts
        rows, found = run([k * STEP // count for k in range(count)])
        results.write(arguments.out / "rows.csv", COLUMNS, rows)
        results.write(arguments.out / "facts.csv", FACTS, found)
    return make(arguments.out)


if __name__ == "__main__":
    print(main())
