"""The metrics of tracks against those of the package trackeval."""

import numpy as np
import pytest

from mixer_torch.boxes import corners, iou, match_boxes
from mixer_torch.io.motchallenge import read_table, read_truth
from mixer_torch.metrics.tracking import COUNTS, evaluate_sequences
from mixer_torch.tracks import Tracks

NOTHING = Tracks([], [], [])


def read(folder):
    """Detections and truth of a sequence, as tables."""
    return read_table(folder / "det" / "det.txt")[0], read_truth(folder / "gt" / "gt.txt")


def as_tracks(rows):
    return Tracks(rows[:, 0].astype(int), rows[:, 1].astype(int), corners(rows[:, 2:6]))


def with_trackeval(results, truths, min_overlap=0.5):
    """What the package trackeval finds, each sequence and all together."""
    metrics = pytest.importorskip("trackeval.metrics")
    options = {"THRESHOLD": min_overlap, "PRINT_CONFIG": False}
    scorers = {
        metrics.HOTA(): HOTA,
        metrics.Identity(options): IDENTITY,
        metrics.CLEAR(options): CLEAR,
    }
    found = {name: {} for name in [*truths, "combined"]}
    for scorer, names in scorers.items():
        each = {
            name: scorer.eval_sequence(timesteps(results[name], truths[name])) for name in truths
        }
        for name, of_one in {**each, "combined": scorer.combine_sequences(each)}.items():
            for key, field in names.items():
                value = float(np.mean(of_one[field]))
                found[name][key] = value if key in COUNTS else 100 * value
    return found


HOTA = dict(zip(*[("HOTA", "DetA", "AssA", "DetRe", "DetPr", "AssRe", "AssPr", "LocA")] * 2))  # noqa: B905
IDENTITY = {"IDF1": "IDF1", "IDP": "IDP", "IDR": "IDR"}
CLEAR = {"MOTA": "MOTA", "MOTP": "MOTP", "TP": "CLR_TP", "FP": "CLR_FP", "FN": "CLR_FN"}
CLEAR |= {name: name for name in ("IDSW", "Frag", "MT", "PT", "ML")}


def timesteps(result, truth):
    """What trackeval's metrics ask for: identities from 0 and similarities, step by step."""
    steps = sorted({*zip(truth.camera, truth.frame), *zip(result.camera, result.frame)})  # noqa: B905
    data = {"num_timesteps": len(steps)}
    for name, tracks in (("gt", truth), ("tracker", result)):
        unique, identity = np.unique(tracks.identity, return_inverse=True)
        rows = [(tracks.camera == camera) & (tracks.frame == frame) for camera, frame in steps]
        data[f"num_{name}_ids"], data[f"num_{name}_dets"] = len(unique), len(tracks)
        data[f"{name}_ids"] = [identity[row] for row in rows]
        data[name] = [tracks.box[row] for row in rows]
    data["similarity_scores"] = [
        iou(a, b) for a, b in zip(data["gt"], data["tracker"], strict=True)
    ]
    return data


def agree(results, truths, min_overlap=0.5):
    expected = with_trackeval(results, truths, min_overlap)
    found = evaluate_sequences(results, truths, min_overlap)
    for name, one in {**found["sequences"], "combined": found["combined"]}.items():
        assert {key: one[key] for key in expected[name]} == pytest.approx(
            expected[name], rel=1e-9, abs=1e-9
        ), name


def disturbed(seed):
    """A result and a truth that differ by all kinds of errors, more or less of each."""
    random = np.random.default_rng(seed)
    objects, frames = random.integers(0, 12), random.integers(1, 30)
    rate = random.uniform(0, 0.5, size=6)
    whole = random.random() < 0.3  # boxes of whole pixels overlap equally now and then
    place = random.uniform(0, 60, size=(objects, 2))
    truth, result, given = [], [], np.arange(1, objects + 1)
    for frame in range(frames):
        place += random.normal(size=place.shape)
        if random.random() < rate[0]:
            given = random.permutation(given)  # switches
        if random.random() < rate[1] and objects:
            given[random.integers(objects)] += objects  # a new identity
        for k in range(objects):
            size = random.uniform(8, 20, size=2)
            box = np.array([*place[k], *(place[k] + size)])
            seen = box + random.normal(size=4) * 4 * rate[2]
            camera = frame % 2 if rate[5] < 0.1 else 0
            if random.random() > rate[3]:
                truth.append((frame, k + 1, camera, *(box.round() if whole else box)))
            if random.random() > rate[4]:
                result.append((frame, given[k], camera, *(seen.round() if whole else seen)))
        for k in range(random.poisson(2 * rate[5])):  # clutter
            box = np.append(corner := random.uniform(0, 60, size=2), corner + 10)
            result.append((frame, 1000 + k, frame % 2 if rate[5] < 0.1 else 0, *box))

    def made(rows):
        table = np.array(rows).reshape(-1, 7)
        whole = table[:, :3].astype(int)
        return Tracks(whole[:, 0], whole[:, 1], table[:, 3:], camera=whole[:, 2])

    return made(result), made(truth)


@pytest.mark.parametrize("seed", range(40))
def test_tracks_with_all_kinds_of_errors_have_the_figures_of_trackeval(seed):
    results, truths = zip(*(disturbed(3 * seed + k) for k in range(3)), strict=True)
    names = ("a", "b", "c")
    agree(
        dict(zip(names, results, strict=True)),
        dict(zip(names, truths, strict=True)),
        (0.5, 0.3, 0.75)[seed % 3],
    )


def test_nothing_found_or_nothing_there_has_the_figures_of_trackeval():
    some = Tracks([1, 2, 2], [1, 1, 3], np.array([[0, 0, 10, 10]] * 3))
    for result in (NOTHING, some):
        for truth in (NOTHING, some):
            agree({"a": result, "b": some}, {"a": truth, "b": some})


@pytest.mark.real_data
def test_real_sequences_have_the_figures_of_trackeval(real_data):
    results, truths = {}, {}
    for folder in sorted((real_data / "mot15").iterdir()):
        rows, truth = read(folder)
        mine, theirs = match_boxes(
            rows[:, 0], corners(rows[:, 2:6]), truth[:, 0], corners(truth[:, 2:6])
        )
        rows[:, 1] = np.arange(len(rows)) % 50 + 1000  # clutter in short pieces
        rows[mine, 1] = truth[theirs, 1] + 100 * (rows[mine, 0] // 40 % 2)  # switches
        _, first = np.unique(rows[:, :2], axis=0, return_index=True)
        results[folder.name], truths[folder.name] = as_tracks(rows[first]), as_tracks(truth)
    agree(results, truths)
