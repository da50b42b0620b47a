"""What tracks are made of, as hypothesis draws it.

Made into tracks in the test: type checks of the library draw random numbers, which hypothesis does
not allow inside of strategies.
"""

import numpy as np
from hypothesis import strategies as st

PIXELS = st.floats(-1e4, 1e4, allow_subnormal=False)
CONFIDENCE = st.floats(0, 1) | st.just(np.nan)


@st.composite
def drawn_tracks(draw, cameras=1):
    """The arguments of tracks of a few frames and identities."""
    whole = st.integers
    place = st.tuples(whole(0, 30), whole(1, 5), whole(0, cameras - 1))
    places = draw(st.lists(place, unique=True, max_size=12))
    rows = [
        (draw(PIXELS), draw(PIXELS), draw(st.floats(0, 500)), draw(st.floats(0, 500)))
        for _ in places
    ]
    left, top, width, height = np.array(rows).reshape(-1, 4).T
    frame, identity, camera = np.array(places, dtype=int).reshape(-1, 3).T
    return {
        "frame": frame,
        "identity": identity,
        "box": np.stack([left, top, left + width, top + height], 1),
        "confidence": np.array([draw(CONFIDENCE) for _ in places]),
        "camera": camera,
        "observation": np.array([draw(whole(-1, 99)) for _ in places], dtype=int),
    }


def assert_same(found, expected, atol=0.0, leave_out=()):
    for name in ("frame", "identity", "camera", "observation"):
        if name not in leave_out:
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), name)
    np.testing.assert_allclose(found.box, expected.box, rtol=1e-12, atol=atol or 1e-9)
    np.testing.assert_allclose(found.confidence, expected.confidence, rtol=atol or 1e-12, atol=atol)
