"""Persons in crops of two cameras: how many there are is not known, and what it would be worth.

Similarity by colour (configs/persons.yaml) and by an appearance network that is trained here first,
unless --embedding names the folder `export` of an earlier training. It learns from 46 persons, some
of which its calibrator is fitted to; the last 16 are held out from both. Every method gets the same
fused costs. Those that are told the number of persons stop there; MIXER is told it by the offset of
all costs that brings the number of its clusters nearest. rank1 and mAP are of the similarity,
before any clustering. Needs MIXER_DATA. Everything but rows.csv is made from it.

    mixer bench persons --out out/benchmarks/persons
"""

import argparse
import math
import time
from importlib import resources
from pathlib import Path

import torch
from scipy.cluster.hierarchy import fcluster, linkage

import mixer_torch as mx
from mixer_torch.association import Association, Status, by_first_appearance
from mixer_torch.benchmarks import comparison, results
from mixer_torch.cli import build_parsers
from mixer_torch.io.files import find
from mixer_torch.metrics.clustering import evaluate
from mixer_torch.metrics.retrieval import retrieval_of_affinity
from mixer_torch.solvers.threshold import AllPairs

MEASURES = ("rank1", "map", "precision", "recall", "f1", "bcubed_f1", "clusters")
COLUMNS = ("persons", "similarity", "method", *MEASURES, "objects", "offset", "seconds")
GALLERIES = {"all 62": (), "16 held out": ("--dataset.skip=46",)}
OFFSETS = (-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 3.0)
"""Nats that each pair costs beside its fused cost: above 0, joining takes more evidence."""
LINKAGES = ("single", "complete", "average")


def gallery(*overrides):
    """Observations, affinity and fusion, as `mixer associate` would read them."""
    parser = build_parsers()[1]["associate"]
    path = resources.files("mixer_torch.configs") / "persons.yaml"
    chosen = parser.instantiate(parser.parse_args([f"--config={path}", "--out=.", *overrides]))
    observations = chosen.dataset.load()
    with torch.no_grad():
        return observations, mx.score(observations, chosen.scorers), chosen.fusion


def shifted(affinity, fusion, offset):
    """The fused scores as one modality, and a fusion that adds an offset to their costs."""
    score = torch.sigmoid(-affinity.cost(fusion).double()).clamp(1e-6, 1 - 1e-6)
    fused = mx.Affinity(affinity.pairs, score[None], affinity.view, ("fused",))
    return fused, mx.LogOddsFusion(cap=14.0, prior=1 / (1 + math.exp(offset)))


def hierarchical(cost, kind, number=None):
    """Agglomerative clusters: so many, or those whose linkage is cheaper than indifference.

    Single linkage, not told the number, joins up all links: connected components.
    """
    least = min(float(cost.min()), 0.0)
    tree = linkage(cost - least, kind)
    if number is not None:
        return fcluster(tree, number, "maxclust")
    return fcluster(tree, -least, "distance")


def methods(observations, affinity, fusion):
    """(name, offset, association) of each method, made one after the other."""
    number = len(observations["identity"].unique())
    cost = affinity.cost(fusion).double()
    yield "MIXER", "", mx.solve(affinity, mx.Mixer(), fusion)
    yield "links", "", mx.solve(shifted(affinity, fusion, 0.0)[0], AllPairs())
    for kind in LINKAGES:
        yield f"{kind} linkage", "", labelled(hierarchical(cost.numpy(), kind))
    for kind in LINKAGES:
        told = labelled(hierarchical(cost.numpy(), kind, number))
        yield f"{kind} linkage, told the number", "", told
    for offset in OFFSETS:
        fused, moved = shifted(affinity, fusion, offset)
        yield "MIXER by offset", offset, mx.solve(fused, mx.Mixer(time_limit=30.0), moved)


def labelled(labels):
    found = by_first_appearance(torch.as_tensor(labels, dtype=torch.int64))
    return Association(found, float("nan"), Status.CONVERGED)


def run(export, thin):
    rows = []
    similarities = {"colour": ()}
    if export is not None:
        similarities["embedding"] = (f"--config={export / 'scorers.yaml'}",)
    for persons, part in GALLERIES.items():
        part = (*part, "--dataset.limit=8") if thin else part
        for similarity, words in similarities.items():
            observations, affinity, fusion = gallery(*words, *part)
            ranked = retrieval_of_affinity(affinity, observations, fusion)
            said = {"persons": persons, "similarity": similarity, **ranked}
            start = time.perf_counter()
            for method, offset, association in methods(observations, affinity, fusion):
                seconds = time.perf_counter() - start
                found = evaluate(association, observations["identity"], observations.view)
                row = said | found | {"method": method, "offset": offset, "seconds": seconds}
                rows.append({key: row.get(key, "") for key in COLUMNS})
                start = time.perf_counter()
            print(f"{persons}, {similarity}: {len(observations)} crops", flush=True)
    return rows


def train(out, quick):
    """Train as configs/train/embedding.yaml says; the folder with what scorers load."""
    from mixer_torch.train.cli import main as mixer_train

    path = resources.files("mixer_torch.configs") / "train" / "embedding.yaml"
    words = ["--config", str(path), "--out", str(out), "--trainer.enable_progress_bar", "false"]
    if quick:
        words += ["--trainer.max_epochs", "2", "--trainer.check_val_every_n_epoch", "1"]
    start = time.perf_counter(), time.process_time()
    if mixer_train(["fit", *words]):
        raise SystemExit("training failed")
    seconds = (time.perf_counter() - start[0], time.process_time() - start[1])
    print("trained in {:.0f} s, {:.0f} s of CPU".format(*seconds), flush=True)
    return out / "export"


def told_the_number(rows):
    """Of MIXER's answers by offset the one whose number of clusters is nearest to the truth's."""
    swept = [row for row in rows if row["method"] == "MIXER by offset"]
    nearest = min(swept, key=lambda row: (abs(row["clusters"] - row["objects"]), row["offset"]))
    return nearest | {"method": f"MIXER, told the number (offset {nearest['offset']:g})"}


def make(out):
    """The table from the rows in a folder; the Markdown comes back."""
    lines = []
    for (persons, similarity), group in results.grouped(
        results.read(out / "rows.csv"), "persons", "similarity"
    ).items():
        first = group[0]
        lines += [
            f"## {persons}, by {similarity}",
            "",
            f"rank-1 {first['rank1']:.3f}, mAP {first['map']:.3f}; {first['objects']:.0f} persons",
            "",
            "| | F1 | precision | recall | B-cubed F1 | clusters | seconds |",
            "|---" * 7 + "|",
        ]
        shown = [row for row in group if row["method"] != "MIXER by offset"]
        for row in [*shown, told_the_number(group)]:
            cells = [f"{row[key]:.3f}" for key in ("f1", "precision", "recall")]
            cells += [f"{row[k]:{p}}" if row[k] != "" else "" for k, p in LAST]
            lines.append(f"| {row['method']} | " + " | ".join(cells) + " |")
        lines.append("")
    text = "\n".join(lines)
    (out / "table.md").write_text(text)
    return text


LAST = (("bcubed_f1", ".3f"), ("clusters", ".0f"), ("seconds", ".2f"))


def main(argv=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/benchmarks/persons"))
    parser.add_argument("--quick", action="store_true", help="2 epochs, 8 persons a gallery")
    parser.add_argument("--from_rows", action="store_true", help="only make the table")
    parser.add_argument("--embedding", type=Path, help="folder `export` of an earlier training")
    arguments = parser.parse_args(argv)
    if not arguments.from_rows:
        find("reid_persons")  # before minutes of training
        export = arguments.embedding or train(arguments.out / "embedding", arguments.quick)
        comparison.warm_up()
        rows = run(export, arguments.quick)
        results.write(arguments.out / "rows.csv", COLUMNS, rows)
    return make(arguments.out)


if __name__ == "__main__":
    print(main())
