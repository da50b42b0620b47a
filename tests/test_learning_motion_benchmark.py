"""The benchmark of learning with motion: its rule is what it says, and goes by training alone."""

from mixer_torch.benchmarks.learning_motion import FOLDS, TRAINING, choose, table


def row(frames, modalities, measured, cllr, f1, method="calibrators"):
    """As measured, and as it is read back from a file."""
    found = {
        "frames": frames,
        "modalities": modalities,
        "method": method,
        "measured": measured,
    }
    return {**found, "seed": "", "cllr": cllr, "f1": f1, "f1_new": f1}


def measured(frames, modalities, cllr, f1, window=0.5):
    """Figures of both sequences of training, as far from their mean, and of the window."""
    pets, town = TRAINING
    return [
        row(frames, modalities, pets, cllr + 0.1, f1 - 0.1),
        row(frames, modalities, town, cllr - 0.1, f1 + 0.1),
        row(frames, modalities, "window", 1.0, window),
    ]


ROWS = [
    *measured(20, "a", cllr=0.1, f1=0.7, window=1.0),
    *measured(20, "b", cllr=0.2, f1=0.7),
    *measured(40, "a", cllr=0.5, f1=0.6),
    *measured(40, "b", cllr=0.4, f1=0.9),
    *measured(60, "a", cllr=0.3, f1=0.8),
    *measured(60, "b", cllr=0.3, f1=0.65),
]


def test_range_by_mean_f1_then_the_least_cllr():
    # Means of F1: 0.7, 0.75 and 0.725.
    assert choose(ROWS) == (40, "b", "calibrators")


def test_the_window_has_no_say():
    without = [found for found in ROWS if found["measured"] != "window"]
    assert choose(without) == choose(ROWS)


def test_the_table_can_be_made_before_the_window_is_looked_at():
    text = table([found for found in ROWS if found["measured"] != "window"])
    assert "| 40 | b | calibrators | 0.500 | 0.800 | 0.300 | 1.000 |  |  |  |" in text
    assert "Up to 40 frames, held out: F1 0.750" in text
    assert "Chosen: 40 frames, b, calibrators" in text
    assert "| 40 | b | calibrators | 0.500 | 0.800 | 0.300 | 1.000 | 1.000 | 0.500 | 0.500 |" in (
        table(ROWS)
    )


def test_no_person_is_in_two_folds():
    for folds in FOLDS:
        persons = [person for fold in folds for person in fold]
        assert len(set(persons)) == len(persons)
