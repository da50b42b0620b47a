"""What the commands of ``mixer`` do: a signature is a schema, and what it returns is printed."""

from __future__ import annotations

import copy
import pkgutil
import time
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import torch
from jsonargparse import lazy_instance

from mixer_torch.affinity import Affinity
from mixer_torch.association import Association, Status
from mixer_torch.datasets.base import Dataset
from mixer_torch.fusion import Fusion, LinearFusion
from mixer_torch.metrics import evaluate as measure
from mixer_torch.observations import Observations
from mixer_torch.outputs import (
    Result,
    check_folder,
    known_identity,
    read_labels,
    staged,
    write_associations,
    write_json,
    write_tables,
)
from mixer_torch.pairs import Every, PairSelector
from mixer_torch.plugins import KINDS, members
from mixer_torch.scoring import Progress, Scorer
from mixer_torch.scoring import score as score_pairs
from mixer_torch.solvers.base import Solver
from mixer_torch.solvers.base import solve as solve_affinity
from mixer_torch.solvers.mixer import Mixer

MIXER: Any = lazy_instance(Mixer)
LINEAR: Any = lazy_instance(LinearFusion)
EVERY: Any = lazy_instance(Every)


def associate(
    dataset: Dataset,
    scorers: list[Scorer],
    out: Path,
    solver: Solver = MIXER,
    pairs: PairSelector = EVERY,
    fusion: Fusion = LINEAR,
    ablate: bool = False,
    video: bool = False,
    device: str = "cpu",
    *,
    config: str,
    progress: Progress,
) -> str:
    """Say which observations are of the same object; write tables, metrics and pictures.

    Args:
        dataset: Where the observations come from.
        scorers: One for each modality.
        out: Folder to write to. What an earlier result left there is replaced.
        solver: The algorithm.
        pairs: Which pairs to compare.
        fusion: How the modalities add up.
        ablate: Solve each modality alone, too, and say how good it is.
        video: Write tracks.mp4, too: every frame, with its boxes.
        device: Where to score and solve: cpu, cuda, or cuda:1 and so on.
        config: The resolved configuration, to be written beside the result.
        progress: Told what is done while it goes on.
    """
    check_folder(out)
    start = time.perf_counter()
    observations, affinity = _score(dataset, scorers, pairs, device, progress)
    scored = time.perf_counter()
    result = _solve(observations, affinity, solver, fusion.to(affinity.scores.device), ablate)
    solved = time.perf_counter()
    with staged(out) as folder:
        write_tables(folder, result)
        (folder / "config.yaml").write_text(config, encoding="utf-8")
        notes = _draw(folder, result, fusion, video, progress)
        written = sorted(path.name for path in folder.iterdir())
    heading = (
        f"{_size(affinity)}; scored in {scored - start:.1f} s, solved in {solved - scored:.1f} s"
    )
    return "\n".join(
        [heading, "", _table(result), "", *_ending(result), *_listing(out, written), *notes]
    )


def score(
    dataset: Dataset,
    scorers: list[Scorer],
    out: Path,
    pairs: PairSelector = EVERY,
    device: str = "cpu",
    *,
    config: str,
    progress: Progress,
) -> str:
    """Compare observations in every modality and keep the scores.

    Args:
        dataset: Where the observations come from.
        scorers: One for each modality.
        out: File to write the affinity to (npz). The resolved configuration goes beside it (yaml).
        pairs: Which pairs to compare.
        device: Where to score: cpu, cuda, or cuda:1 and so on.
        config: The resolved configuration, to be written beside the result.
        progress: Told what is done while it goes on.
    """
    _check_suffix("out", out, ".npz")
    affinity = _score(dataset, scorers, pairs, device, progress)[1]
    out.parent.mkdir(parents=True, exist_ok=True)
    affinity.save(out)
    out.with_suffix(".yaml").write_text(config, encoding="utf-8")
    return f"{_size(affinity)}\nwritten: {out}, {out.with_suffix('.yaml')}"


def solve(
    affinity: Path,
    out: Path | None = None,
    solver: Solver = MIXER,
    fusion: Fusion = LINEAR,
    device: str = "cpu",
    *,
    config: str,
) -> str:
    """Find the clusters that agree best with scores that were kept.

    Args:
        affinity: File that `mixer score` wrote (npz).
        out: File to write the association to: npz, or csv for a table of labels. The resolved
            configuration goes beside it, as yaml. Nothing is written if there is none.
        solver: The algorithm.
        fusion: How the modalities add up.
        device: Where to solve: cpu, cuda, or cuda:1 and so on.
        config: The resolved configuration, to be written beside the result.
    """
    if out is not None:
        _check_suffix("out", out, ".npz", ".csv")
    scores = Affinity.load(affinity).to(_device(device))
    association = solve_affinity(scores, solver, fusion.to(scores.scores.device))
    lines = [_size(scores), _clusters(association), *_status(association)]
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        if out.suffix == ".npz":
            association.save(out)
        else:
            write_associations(out, Observations(scores.view), association.labels)
        out.with_suffix(".yaml").write_text(config, encoding="utf-8")
        lines.append(f"written: {out}, {out.with_suffix('.yaml')}")
    return "\n".join(lines)


def evaluate(result: Path, dataset: Dataset | None = None, out: Path | None = None) -> str:
    """Measure an association against the truth.

    Args:
        result: associations.csv as `mixer associate` writes it, any CSV with a column `label` (and
            `observation`, the number of the row of the dataset), or an association in npz.
        dataset: Where the truth comes from. Where there is none, it is in the CSV's columns
            `identity` and `view`.
        out: File to write the metrics to (json); only printed if there is none.
    """
    if out is not None:
        _check_suffix("out", out, ".json")
    table = {} if result.suffix == ".npz" else read_labels(result)
    if dataset is not None:
        observations = dataset.load()
        identity, view = known_identity(observations), observations.view
        if identity is None:
            raise ValueError("dataset: expected known identities (a feature 'identity'), got none")
    elif {"identity", "view"} <= set(table):
        identity, view = table["identity"], table["view"]
    else:
        raise ValueError(
            f"dataset: expected one, as {result} has no columns 'identity' and 'view' to take the "
            "truth from"
        )
    association = _labelled(table, len(view)) if table else Association.load(result)
    metrics = {"all": measure(association, identity, view)}
    lines = [_metrics_table(metrics, ("precision", "recall", "f1", "bcubed_f1", "adjusted_rand"))]
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_json(out, metrics)
        lines.append(f"written: {out}")
    return "\n".join(lines)


def list_members() -> str:
    """List the scorers, solvers, datasets and the rest that a configuration may name."""
    blocks = []
    for kind in KINDS:
        found = members(kind)
        width = max((len(member.class_path) for member in found), default=0)
        rows = [f"  {member.class_path:<{width}}  {member.summary}" for member in found]
        blocks.append("\n".join([kind.name, *(rows or ["  none"])]))
    return "\n\n".join(blocks)


def bench(name: str, out: Path | None = None, quick: bool = False, from_rows: bool = False) -> str:
    """Run a benchmark: rows first, then tables and figures, which are made from the rows alone.

    Args:
        name: Which of the modules in the folder `benchmarks`, such as table2.
        out: Folder to write to; out/benchmarks/NAME if there is none.
        quick: A small run, to see that it works.
        from_rows: Run nothing, and make tables and figures from the rows that are there.
    """
    package = import_module("mixer_torch.benchmarks")
    found = sorted(module.name for module in pkgutil.iter_modules(package.__path__))
    module = import_module(f"{package.__name__}.{name}") if name in found else None
    run = getattr(module, "main", None)
    if run is None:
        raise ValueError(f"name: expected a benchmark, one of {', '.join(found)}, got {name!r}")
    folder = out or Path("out", "benchmarks", name)
    switches = {"--quick": quick, "--from_rows": from_rows}
    options = [option for option, given in switches.items() if given]
    text = run(["--out", str(folder), *options])
    return f"{text or ''}\nwritten to {folder}".lstrip()


def _score(
    dataset: Dataset,
    scorers: list[Scorer],
    pairs: PairSelector,
    device: str,
    progress: Progress,
) -> tuple[Observations, Affinity]:
    place = _device(device)
    observations = dataset.load().to(place)
    with torch.no_grad():
        affinity = score_pairs(
            observations, [scorer.to(place) for scorer in scorers], pairs, progress
        )
    return observations, affinity


def _solve(
    observations: Observations, affinity: Affinity, solver: Solver, fusion: Fusion, ablate: bool
) -> Result:
    association = solve_affinity(affinity, solver, fusion)
    alone = {}
    for name in affinity.modalities if ablate else ():
        alone[name] = solve_affinity(affinity.select(name), solver, _only(fusion, name))
    return Result(observations, affinity, association, alone)


def _only(fusion: Fusion, modality: str) -> Fusion:
    """The fusion without the weights of other modalities, which are not there to be weighted."""
    single = copy.deepcopy(fusion)
    single.weights = {name: weight for name, weight in fusion.weights.items() if name == modality}
    return single


def _draw(
    folder: Path, result: Result, fusion: Fusion, video: bool, progress: Progress
) -> list[str]:
    """Draw what can be drawn, and say why the rest cannot."""
    from mixer_torch import plots

    progress("pictures", 0, 3)
    association, observations = result.association, result.observations
    with torch.no_grad():
        figure = plots.affinity_figure(result.affinity, association, result.identity, fusion)
    plots.save(figure, folder / "affinity.png")
    progress("pictures", 1, 3)
    if observations.images is None:
        return ["no pictures of crops and frames: the dataset has no images"]
    if association.labels is None:
        return ["no pictures of crops and frames: the solver gave links and no clusters"]
    figure = plots.clusters_figure(observations, association.labels)
    plots.save(figure, folder / "clusters.png")
    progress("pictures", 2, 3)
    if observations.images.box is None:
        return ["no picture of frames: each image is one observation"]
    plots.save(plots.frames_figure(observations, association.labels), folder / "frames.png")
    if video:
        plots.write_video(folder / "tracks.mp4", observations, association.labels, progress)
    return []


def _device(name: str) -> torch.device:
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ValueError(f"device: expected one that is here, got {name!r}: {reason}") from error
    return device


def _labelled(table: Mapping[str, torch.Tensor], m: int) -> Association:
    """The association of a table whose rows may be in any order."""
    labels = table["label"]
    if len(labels) != m:
        raise ValueError(f"result: expected {m} rows, one an observation, got {len(labels)}")
    if "observation" in table:
        order = table["observation"].argsort()
        if not torch.equal(table["observation"][order], torch.arange(m)):
            raise ValueError(f"result: expected each observation 0..{m - 1} once in its column")
        labels = labels[order]
    return Association(labels, float("nan"), Status.CONVERGED)


def _check_suffix(name: str, path: Path, *suffixes: str) -> None:
    if path.suffix not in suffixes:
        raise ValueError(f"{name}: expected a file name in {' or '.join(suffixes)}, got {path}")


def _size(affinity: Affinity) -> str:
    views = len(torch.unique(affinity.view))
    modalities = ", ".join(affinity.modalities)
    pairs = affinity.pairs.shape[1]
    return f"{len(affinity):,} observations in {views:,} views, {pairs:,} pairs, {modalities}"


def _clusters(association: Association) -> str:
    if association.num_clusters is None:
        return f"{association.links.shape[1]:,} links"
    return f"{association.num_clusters:,} clusters"


def _status(association: Association) -> list[str]:
    bound = "" if association.gap is None else f" (gap {association.gap:.2%})"
    return [f"objective {association.objective:.6g}{bound}", f"status: {association.status.value}"]


def _table(result: Result) -> str:
    metrics = result.metrics()
    if metrics is not None:
        return _metrics_table(metrics, ("precision", "recall", "f1"))
    rows = [*result.alone.items(), ("all", result.association)]
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {_clusters(association)}" for name, association in rows)


def _metrics_table(metrics: Mapping[str, Any], columns: tuple[str, ...]) -> str:
    """Rows of metrics, the single modalities first, and the true number of clusters at the end."""
    rows = {**metrics.get("alone", {}), "all": metrics["all"]}
    shown = [name for name in columns if name in metrics["all"]]
    titles = [("F1" if name == "f1" else name.replace("_", " ")) for name in shown]
    width = max(len(name) for name in [*rows, "truth"])
    widths = [max(len(title), 9) for title in titles]
    lines = [
        " " * width
        + "".join(f"  {t:>{w}}" for t, w in zip(titles, widths, strict=True))
        + "  clusters"
    ]
    for name, row in rows.items():
        cells = "".join(f"  {row[c]:>{w}.3f}" for c, w in zip(shown, widths, strict=True))
        lines.append(f"{name:<{width}}{cells}  {row.get('clusters', '-'):>8}")
    if "objects" in metrics["all"]:
        blank = "".join(" " * (w + 2) for w in widths)
        lines.append(f"{'truth':<{width}}{blank}  {metrics['all']['objects']:>8}")
    return "\n".join(lines)


def _ending(result: Result) -> list[str]:
    return _status(result.association)


def _listing(out: Path, written: list[str]) -> list[str]:
    pictures = [name for name in written if name.endswith((".png", ".mp4"))]
    others = [name for name in written if name not in pictures]
    return [
        f"written to {out}: {', '.join(others)}",
        *(f"picture: {out / name}" for name in pictures),
    ]
