"""Time and memory against the number of observations m, and the objective beside a peer's.

Three series, each step in a process of its own:

- degree: video of 50 detections a frame, each pair within two frames listed, so that an observation
  has 200 pairs whatever m; 1,000 frames are m = 50,000 and 5 million pairs.
- dense: all pairs of about m observations in 20 views, four modalities.
- batch: 1,024 problems of about 50 observations, in one call and one after the other.

Time does not grow with m everywhere: what fits into one matrix (1,000 nodes) is searched whole,
the smaller the more often and the longer; larger problems are searched subproblem by subproblem.

The peer on the same input is greedy contraction alone (GAEC), and followed by Kernighan-Lin with
joins (KLj): kernighan_lin.py, which shares no code with the solver. Dense problems are drawn with
three seeds, the others with one.
Peak memory is that of the process, less what it held before the problem was solved, without the
input; on CUDA that of the device. The largest step of the first series is profiled. Where there is
a GPU all of it is solved there, too, which leaves the peer out.

    mixer bench scaling --out out/benchmarks/scaling
    python -m mixer_torch.benchmarks.scaling --device cuda --out out/benchmarks/scaling_gpu
"""

import cProfile
import pstats
import resource
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import torch
from tqdm import tqdm

import mixer_torch as mx
from mixer_torch.benchmarks import kernighan_lin, results
from mixer_torch.datasets.synthetic import synthetic
from mixer_torch.solvers.problem import objective_of, problem_of

DETECTIONS, WINDOW = 50, 2  # in a frame; frames between the two of a pair
FRAMES = (4, 10, 30, 100, 300, 1000)
DENSE = (100, 200, 400, 800, 1500, 3000)
PROBLEMS = 1024
SEEDS = 3  # of dense problems
PEERS = ("greedy", "klj")
SOLVED = ("seconds", "peak_mib", "objective")
PEER_COLUMNS = tuple(f"{what}_{peer}" for peer in PEERS for what in ("seconds", "objective"))
COLUMNS = ("series", "seed", "device", "m", "pairs", "problems", *SOLVED, *PEER_COLUMNS)


def video(frames, seed=0, wrong=0.1, noise=0.25, lost=0.1):
    """An affinity of detections of objects that come and go, pairs within a few frames listed.

    In each frame an object is replaced by a new one with probability 0.02, and its detection is of
    nothing seen elsewhere with probability ``lost``. A score is 0.8 for the same object and 0.2 for
    others, swapped with probability ``wrong``, plus Gaussian noise, clipped to [0, 1].
    """
    rng = np.random.default_rng(seed)
    identity = np.empty((frames, DETECTIONS), np.int64)
    present, fresh = np.arange(DETECTIONS), DETECTIONS
    for f in range(frames):
        identity[f] = present
        clutter = rng.random(DETECTIONS) < lost
        gone = rng.random(DETECTIONS) < 0.02
        new = fresh + np.arange(2 * DETECTIONS)
        identity[f, clutter] = new[:DETECTIONS][clutter]
        present = np.where(gone, new[DETECTIONS:], present)
        fresh += 2 * DETECTIONS
    m = frames * DETECTIONS
    first = np.arange(m)
    end = np.minimum((first // DETECTIONS + 1 + WINDOW) * DETECTIONS, m)
    begin = (first // DETECTIONS + 1) * DETECTIONS
    count = np.maximum(end - begin, 0)
    near = np.repeat(first, count)
    far = np.arange(len(near)) - np.repeat(np.cumsum(count) - count, count) + begin[near]
    same = identity.reshape(-1)[near] == identity.reshape(-1)[far]
    same ^= rng.random(len(same)) < wrong
    score = np.where(same, 0.8, 0.2) + noise * rng.normal(size=len(same))
    return mx.Affinity(
        torch.from_numpy(np.stack([near, far])),
        torch.from_numpy(score.clip(0, 1).astype(np.float32))[None],
        torch.from_numpy(first // DETECTIONS),
        ("synthetic",),
    )


def dense(m, seed=0):
    """All pairs of about m observations in 20 views, four noisy modalities."""
    return synthetic(
        objects=round(m / 12.5), views=20, modalities=4, wrong=0.3, noise=0.4, seed=seed
    )[0]


def small(count):
    """Problems of about 50 observations, as those of the paper's Table I."""
    return [synthetic(objects=10, views=8, wrong=0.1, noise=0.3, seed=s)[0] for s in range(count)]


class Peak:
    """Highest memory in MiB while solving, over that before: of the device, or of the process.

    The highest of a process so far cannot be reset, so a thread looks at what it holds now.
    """

    def __init__(self, device):
        self.on_gpu = device != "cpu"

    def __enter__(self):
        if self.on_gpu:
            torch.cuda.synchronize()
            torch.cuda.reset_peak_memory_stats()
            self.base = torch.cuda.memory_allocated()
        else:
            self.base = self.highest = _resident()
            self.over = threading.Event()
            self.thread = threading.Thread(target=self._watch, daemon=True)
            self.thread.start()
        return self

    def _watch(self):
        while not self.over.wait(0.005):
            self.highest = max(self.highest, _resident())

    def __exit__(self, *_):
        if self.on_gpu:
            torch.cuda.synchronize()
            self.highest = torch.cuda.max_memory_allocated()
        else:
            self.over.set()
            self.thread.join()
        self.mib = (self.highest - self.base) / 2**20


def _resident():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()


def timed(device, function):
    """Its result, seconds and peak memory, measured on the second run of two where it is short."""
    for _ in range(2):
        with Peak(device) as peak:
            begin = time.perf_counter()
            result = function()
            if device != "cpu":
                torch.cuda.synchronize()
            seconds = time.perf_counter() - begin
        if seconds > 10:
            break
    return result, seconds, peak.mib


def step(series, size, seed, device):
    """One row, or two of the batch; runs in a process of its own."""
    warm = [video(6), dense(60)]
    mx.solve([affinity.to(device) for affinity in warm])  # kernels are compiled or loaded
    if device == "cpu":
        peer(warm[0])
    if series == "batch":
        return batch_rows(size, device)
    affinity = (video if series == "degree" else dense)(size, seed)
    there = affinity.to(device)
    answer, seconds, peak = timed(device, lambda: mx.solve(there))
    row = {"series": series, "seed": seed, "device": name_of(device), "m": len(affinity)}
    row |= {"pairs": affinity.pairs.shape[1], "seconds": seconds, "peak_mib": peak, "problems": 1}
    row["objective"] = answer.objective
    return [row | peer(affinity) if device == "cpu" else row]


def name_of(device):
    """The CPU is "cpu"; a GPU has the name that its maker gave it."""
    return device if device == "cpu" else torch.cuda.get_device_name()


def peer(affinity):
    """Seconds and objectives of greedy contraction, and of that and Kernighan-Lin with joins."""
    problem = problem_of(affinity)
    view = affinity.view.numpy()
    graph = kernighan_lin.graph_of(problem.pairs.numpy(), problem.cost.double().numpy(), view)
    begin = time.perf_counter()
    contracted = kernighan_lin.gaec(*graph)
    middle = time.perf_counter()
    improved = kernighan_lin.klj(*graph, contracted)
    end = time.perf_counter()
    found = {"greedy": (contracted, middle - begin), "klj": (improved, end - begin)}
    row = {}
    for name, (label, seconds) in found.items():
        row[f"seconds_{name}"] = seconds
        row[f"objective_{name}"] = objective_of(problem, torch.from_numpy(label))
    return row


def batch_rows(count, device):
    """Many small problems together, and each by itself."""
    affinities = small(count)
    row = {"device": name_of(device), "seed": 0, "problems": count, "m": sum(map(len, affinities))}
    row["pairs"] = sum(affinity.pairs.shape[1] for affinity in affinities)
    if device == "cpu":
        peers = [peer(affinity) for affinity in affinities]
        row |= {column: sum(own[column] for own in peers) for column in PEER_COLUMNS}
    there = [affinity.to(device) for affinity in affinities]
    ways = {
        "batch": lambda: mx.solve(there),
        "one by one": lambda: [mx.solve(affinity) for affinity in there],
    }
    rows = []
    for series, solve in ways.items():
        answers, seconds, peak = timed(device, solve)
        objective = sum(answer.objective for answer in answers)
        rows.append(row | {"series": series, "seconds": seconds, "peak_mib": peak})
        rows[-1]["objective"] = objective
    return rows


def profile(frames):
    """Where the time of one solve goes, as text."""
    affinity = video(frames)
    mx.solve(video(6))
    with cProfile.Profile() as profiler:
        mx.solve(replace(affinity))
    stats = pstats.Stats(profiler).strip_dirs().sort_stats("cumulative")
    lines = []
    for (file, _, name), (_, calls, own, total, _) in stats.stats.items():
        if total > 0.01:
            lines.append((total, f"{total:8.2f} {own:8.2f} {calls:8d}  {file} {name}"))
    shown = [line for _, line in sorted(lines, reverse=True)[:40]]
    return "\n".join([f"m = {len(affinity)}", "   total      own    calls", *shown, ""])


def run(quick, devices):
    steps = [
        *(("degree", frames, 0) for frames in (FRAMES[:3] if quick else FRAMES)),
        *(
            ("dense", m, seed)
            for m in (DENSE[:3] if quick else DENSE)
            for seed in range(1 if quick else SEEDS)
        ),
        ("batch", 64 if quick else PROBLEMS, 0),
    ]
    rows = []
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as pool:
        for device in devices:
            for one in tqdm(steps, device, disable=None):
                rows += pool.submit(step, *one, device).result()
    return rows


def main(argv=None):
    device = ("", "cpu or cuda; the CPU, and the GPU where there is one, if not given")
    arguments = results.arguments((__file__, __doc__), argv, "small sizes only", device=device)
    if not arguments.from_rows:
        there = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
        devices = [arguments.device] if arguments.device else there
        results.write(arguments.out / "rows.csv", COLUMNS, run(arguments.quick, devices))
        frames = FRAMES[2] if arguments.quick else FRAMES[-1]
        if "cpu" in devices:
            (arguments.out / "profile.txt").write_text(profile(frames))
    rows = results.read(arguments.out / "rows.csv")
    text = table(rows)
    (arguments.out / "table.md").write_text(text)
    plot(rows, arguments.out / "scaling.png")
    return text


def table(rows):
    lines = [
        "| series | device | seed | m | pairs | s | ms a problem | MiB | objective | GAEC | s "
        "| GAEC + KLj | s |",
        "|---|---|" + "---:|" * 11,
    ]
    for row in rows:
        each = 1000 * row["seconds"] / row["problems"]
        lines.append(
            f"| {row['series']} | {row['device']} | {row['seed']:.0f} | {row['m']:.0f} "
            f"| {row['pairs']:.0f} "
            f"| {row['seconds']:.3f} | {each:.2f} | {row['peak_mib']:.0f} "
            f"| {row['objective']:.2f} | {shown(row['objective_greedy'], 2)} "
            f"| {shown(row['seconds_greedy'], 3)} | {shown(row['objective_klj'], 2)} "
            f"| {shown(row['seconds_klj'], 3)} |"
        )
    return "\n".join([*lines, "", f"{results.machine()}.", ""])


def shown(value, digits):
    """A number, or a dash where nothing was measured."""
    return "-" if value == "" else f"{value:.{digits}f}"


def plot(rows, path):
    """Seconds and memory against m, both axes logarithmic."""
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    for (series, device), group in results.grouped(rows, "series", "device").items():
        group = [row for row in group if row["seed"] == 0]
        m = [row["m"] for row in group]
        # what fits into memory that the process has freed before cannot be seen
        memory = [max(row["peak_mib"], 1) for row in group]
        for axis, value in zip(axes, ([row["seconds"] for row in group], memory), strict=True):
            axis.plot(m, value, "o-", label=f"{series}, {device}")
    for axis, name in zip(axes, ("time, s", "peak memory, MiB (1 or less as 1)"), strict=True):
        axis.set(xscale="log", yscale="log", xlabel="observations m", ylabel=name)
        axis.grid(alpha=0.3)
    figure.legend(
        *axes[0].get_legend_handles_labels(), fontsize=8, ncols=4, loc="outside upper center"
    )
    figure.savefig(path, dpi=150)
    plt.close(figure)


if __name__ == "__main__":
    print(main())
