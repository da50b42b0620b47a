"""`mixer associate`, and its two steps one by one, `mixer score` and `mixer solve`."""

from __future__ import annotations

import copy
import time
from pathlib import Path
from typing import Any

import torch
from jsonargparse import lazy_instance

from mixer_torch.affinity import Affinity
from mixer_torch.commands.text import (
    check_suffix,
    clusters,
    listing,
    result_table,
    size,
    status,
)
from mixer_torch.datasets.base import Dataset
from mixer_torch.extras import require
from mixer_torch.fusion import Fusion, LinearFusion
from mixer_torch.io.files import check_folder
from mixer_torch.io.results import Result, staged, write_associations, write_tables
from mixer_torch.observations import Observations
from mixer_torch.pairs import Every, PairSelector
from mixer_torch.plots.affinity import affinity_figure
from mixer_torch.plots.clusters import clusters_figure
from mixer_torch.plots.frames import frames_figure, write_video
from mixer_torch.plots.style import save
from mixer_torch.scoring import Progress, Scorer
from mixer_torch.scoring import score as score_pairs
from mixer_torch.solvers.base import solve as solve_affinity
from mixer_torch.solvers.mixer import Mixer
from mixer_torch.solvers.problem import Solver

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
        dataset: Source of the observations.
        scorers: One for each modality.
        out: Folder to write to. An earlier result there is replaced.
        solver: The algorithm.
        pairs: Which pairs to compare.
        fusion: How the modalities add up to one cost of a pair.
        ablate: Solve each modality alone, too, and measure it.
        video: Write tracks.mp4, too: every frame, with its boxes.
        device: Where to score and solve: cpu, cuda, or cuda:1 and so on.
        config: The resolved configuration, to be written beside the result.
        progress: Called with stage, number done and total while the work goes on.
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
        f"{size(affinity)}; scored in {scored - start:.1f} s, solved in {solved - scored:.1f} s"
    )
    return "\n".join(
        [
            heading,
            "",
            result_table(result),
            "",
            *status(result.association),
            *listing(out, written),
            *notes,
        ]
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
    """Compare observations in every modality and write the scores to a file.

    Args:
        dataset: Source of the observations.
        scorers: One for each modality.
        out: File to write the affinity to (npz). The resolved configuration goes beside it (yaml).
        pairs: Which pairs to compare.
        device: Where to score: cpu, cuda, or cuda:1 and so on.
        config: The resolved configuration, to be written beside the result.
        progress: Called with stage, number done and total while the work goes on.
    """
    check_suffix("out", out, ".npz")
    affinity = _score(dataset, scorers, pairs, device, progress)[1]
    out.parent.mkdir(parents=True, exist_ok=True)
    affinity.save(out)
    out.with_suffix(".yaml").write_text(config, encoding="utf-8")
    return f"{size(affinity)}\nwritten: {out}, {out.with_suffix('.yaml')}"


def solve(
    affinity: Path,
    out: Path | None = None,
    solver: Solver = MIXER,
    fusion: Fusion = LINEAR,
    device: str = "cpu",
    *,
    config: str,
) -> str:
    """Find the clusters that agree best with the scores of `mixer score`.

    Args:
        affinity: File that `mixer score` wrote (npz).
        out: File to write the association to: npz, or csv for a table of labels. The resolved
            configuration goes beside it, as yaml. If null, nothing is written.
        solver: The algorithm.
        fusion: How the modalities add up to one cost of a pair.
        device: Where to solve: cpu, cuda, or cuda:1 and so on.
        config: The resolved configuration, to be written beside the result.
    """
    if out is not None:
        check_suffix("out", out, ".npz", ".csv")
    scores = Affinity.load(affinity).to(device_named(device))
    association = solve_affinity(scores, solver, fusion.to(scores.scores.device))
    lines = [size(scores), clusters(association), *status(association)]
    if out is not None:
        out.parent.mkdir(parents=True, exist_ok=True)
        if out.suffix == ".npz":
            association.save(out)
        else:
            write_associations(out, Observations(scores.view), association.labels)
        out.with_suffix(".yaml").write_text(config, encoding="utf-8")
        lines.append(f"written: {out}, {out.with_suffix('.yaml')}")
    return "\n".join(lines)


def _score(
    dataset: Dataset,
    scorers: list[Scorer],
    pairs: PairSelector,
    device: str,
    progress: Progress,
) -> tuple[Observations, Affinity]:
    place = device_named(device)
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
    return Result(observations, affinity, association, alone, fusion)


def _only(fusion: Fusion, modality: str) -> Fusion:
    """The fusion for one modality: weights of others would be refused as unknown names."""
    single = copy.deepcopy(fusion)
    single.weights = {name: weight for name, weight in fusion.weights.items() if name == modality}
    return single


def _draw(
    folder: Path, result: Result, fusion: Fusion, video: bool, progress: Progress
) -> list[str]:
    """Draw the pictures that the data allow; returns notes on those that they do not."""
    try:
        require("matplotlib", extra="plots")
    except ImportError as error:
        return [f"no pictures: {error}"]
    progress("pictures", 0, 3)
    association, observations = result.association, result.observations
    with torch.no_grad():
        figure = affinity_figure(result.affinity, association, result.identity, fusion)
    save(figure, folder / "affinity.png")
    progress("pictures", 1, 3)
    if observations.images is None:
        return ["no pictures of crops and frames: the dataset has no images"]
    if association.labels is None:
        return ["no pictures of crops and frames: the solver gave links and no clusters"]
    figure = clusters_figure(observations, association.labels)
    save(figure, folder / "clusters.png")
    progress("pictures", 2, 3)
    if observations.images.box is None:
        return ["no picture of frames: each image is one observation"]
    save(frames_figure(observations, association.labels), folder / "frames.png")
    if video:
        write_video(folder / "tracks.mp4", observations, association.labels, progress)
    return []


def device_named(name: str) -> torch.device:
    """The device of that name; a ValueError that names the option if this machine has none."""
    try:
        device = torch.device(name)
        torch.empty(0, device=device)
    except (RuntimeError, AssertionError) as error:
        reason = str(error).splitlines()[0]
        raise ValueError(f"device: expected one that is here, got {name!r}: {reason}") from error
    return device
