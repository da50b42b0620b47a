"""What is painted on a car: windows, lamps, doors, number plates, stickers and dirt."""

from __future__ import annotations

from typing import Any

import numpy as np

from mixer_torch.demo.cars import DRAWN_HEIGHT, Body
from mixer_torch.demo.textures import CHROME, GLASS, MATTE, PAINT, Canvas, blotches

TINT = (24, 30, 33)
BLACK = (16, 16, 17)
SEAM = 0.014  # width of the gap around a door, metres
RED_LAMP = (150, 16, 14)
AMBER_LAMP = (205, 110, 20)
CLEAR_LAMP = (215, 222, 226)
STICKERS = (
    (225, 40, 45),
    (35, 85, 200),
    (245, 205, 40),
    (40, 150, 75),
    (240, 240, 240),
    (20, 20, 20),
)
LETTERS = "ABCDEFGHJKLMNPRSTUVWXYZ"


def paint_car(body: Body, colour: Any, generator: np.random.Generator) -> list[np.ndarray]:
    """The textures of one car, in the order LEFT to DARK of its mesh.

    What the model and the colour leave open (plate, stickers, dirt, what lies in the windows) is
    drawn from the generator, so that two of the same model and colour are twins, not copies.
    """
    colour = np.asarray(colour, float)
    plate = _plate_text(generator)
    dirt = generator.uniform(0.2, 1.0)
    right, front = _side(body, colour), _face(body, colour, True)
    left = _side(body, colour)
    left.rgb[:], left.material[:] = left.rgb[:, ::-1].copy(), left.material[:, ::-1].copy()
    back, top = _face(body, colour, False), _roof(body, colour)
    _side_details(left, body, 0.55 * left.size[0], generator)
    _side_details(right, body, 0.14 * right.size[0], generator)
    _number_plate(front, 0.42 + 0.3 * (body.clearance - 0.2), plate, (238, 238, 232))
    _number_plate(back, 0.62 if body.wheel < 0.33 else 0.78, plate, (236, 205, 70))
    _windscreen_details(front, body, generator)
    _tail_details(back, body, generator)
    for canvas in (left, right, front, back):
        canvas.mottle(generator, 0.5, 0.025)
        _dirty(canvas, dirt, generator)
    top.mottle(generator, 0.25, 0.02 + 0.04 * dirt)
    rim = _rim(body, generator)
    dark = Canvas(0.1, 0.1, BLACK, MATTE)
    return [part.texture() for part in (left, right, front, back, top, rim, dark)]


def _plate_text(generator: np.random.Generator) -> str:
    letters = generator.choice(list(LETTERS), 4)
    return f"{letters[0]}{letters[1]} {generator.integers(10, 99)} {letters[2]}{letters[3]}"


def _side(body: Body, colour: np.ndarray) -> Canvas:
    """The right side: the car's front is on the right of the texture."""
    canvas = Canvas(body.length + 0.4, DRAWN_HEIGHT, colour)
    shift = canvas.size[0] / 2

    def at(station: Any) -> Any:
        return shift + body.length * (0.5 - np.asarray(station))

    sill = body.clearance + 0.13
    canvas.rectangle(0, 0, canvas.size[0], sill, (30, 30, 31), MATTE)
    crease = [(at(s), 0.62 * float(body.shoulder(s))) for s in (0.22, 0.5, 0.78)]
    canvas.line(crease, colour * 0.72, 0.02)
    _side_windows(canvas, body, colour, at)
    middle = 0.5 * (body.cabin[1] + body.cabin[2]) - 0.02
    doors = [body.cabin[0] + 0.035, middle, min(body.cabin[2] + 0.01, body.axles[1] - 0.02)]
    if body.name == "compact":
        doors = [body.cabin[0] + 0.035, middle + 0.08]
    for station in doors:
        upper = float(body.shoulder(np.array(station)))
        canvas.line([(at(station), sill), (at(station), upper)], colour * 0.3, SEAM)
    for station in doors[1:]:
        canvas.rectangle(at(station) + 0.06, 0.83 * body.belt[0], 0.19, 0.035, colour * 0.6, CHROME)
    for station in body.axles:
        canvas.ellipse(at(station), body.wheel, body.wheel * 1.17, body.wheel * 1.17, BLACK, MATTE)
    lamp = float(body.top(np.array(0.06)))
    canvas.polygon(
        [(at(-0.01), lamp - 0.16), (at(0.07), lamp - 0.11), (at(0.055), lamp - 0.02),
         (at(0), lamp)],
        CLEAR_LAMP, CHROME,
    )  # fmt: skip
    tail = body.belt[1] - 0.06
    canvas.polygon(
        [(at(1.02), tail - 0.2), (at(0.965), tail - 0.15), (at(0.955), tail), (at(1.02), tail)],
        RED_LAMP, PAINT,
    )  # fmt: skip
    canvas.rectangle(at(0.055), 0.5, 0.1, 0.03, AMBER_LAMP, MATTE)
    return canvas


def _side_windows(canvas: Canvas, body: Body, colour: np.ndarray, at: Any) -> None:
    """Glass between belt and roof, divided by pillars; what is inside shows faintly."""
    front, roof_front, roof_rear, rear = body.cabin
    stations = np.linspace(front + 0.035, rear - 0.02, 60)
    belt = body.shoulder(stations) + 0.02
    top = body.shoulder(stations) + 0.80 * (body.top(stations) - body.shoulder(stations)) - 0.01
    high = top > belt + 0.05
    outline = np.concatenate([
        np.stack([at(stations), belt], 1)[high], np.stack([at(stations), top], 1)[high][::-1]
    ])  # fmt: skip
    canvas.polygon(outline, TINT, GLASS)
    inside = np.array(TINT) * 1.9
    middle = 0.5 * (roof_front + roof_rear)
    for station in (middle - 0.03, middle + 0.17):
        seat, low = at(station + 0.015), float(body.shoulder(np.array(station)))
        canvas.rectangle(seat - 0.09, low + 0.02, 0.18, 0.16, inside)
        canvas.rectangle(seat - 0.06, low + 0.20, 0.12, 0.09, inside)
    if body.name == "van":
        canvas.rectangle(at(0.93), body.belt[0], 0.45 * body.length, 0.75, colour, PAINT)
    canvas.line(outline, BLACK, 0.03)
    pillars = [middle - 0.02] if body.name == "compact" else [middle - 0.02, middle + 0.21]
    for station in pillars:
        spot = at(station)
        low = float(body.shoulder(np.array(station)))
        high_ = float(body.top(np.array(station)))
        canvas.polygon(
            [(spot - 0.05, low), (spot + 0.05, low), (spot + 0.03, high_), (spot - 0.05, high_)],
            BLACK, MATTE,
        )  # fmt: skip


def _face(body: Body, colour: np.ndarray, is_front: bool) -> Canvas:
    """Front or back as seen from there."""
    canvas = Canvas(body.width + 0.2, DRAWN_HEIGHT, colour, density=150)
    middle, half = canvas.size[0] / 2, body.width / 2
    canvas.rectangle(0, 0, canvas.size[0], body.clearance + 0.16, (28, 28, 29), MATTE)
    roof = float(body.top(np.array(0.55)))
    low = body.belt[0] + 0.06 if is_front else body.belt[1] + 0.08
    wide, narrow = 0.80 * half, 0.66 * half
    if is_front or body.name != "van":
        canvas.polygon(
            [(middle - wide, low), (middle + wide, low), (middle + narrow, roof - 0.10),
             (middle - narrow, roof - 0.10)], TINT, GLASS,
        )  # fmt: skip
    _lamps(canvas, body, colour, is_front)
    return canvas


def _lamps(canvas: Canvas, body: Body, colour: np.ndarray, is_front: bool) -> None:
    middle, half = canvas.size[0] / 2, body.width / 2
    if is_front:
        height = float(body.top(np.array(0.03))) - 0.10
        wide = 0.5 * half
        canvas.rectangle(middle - wide, 0.33, 2 * wide, 0.16, BLACK, MATTE)
        canvas.rectangle(middle - wide * 0.9, height - 0.07, 1.8 * wide, 0.11, BLACK, MATTE)
        for bar in range(body.rim % 3 + 1):
            y = height - 0.06 + 0.04 * bar
            canvas.rectangle(middle - wide * 0.85, y, 1.7 * wide, 0.012, (190, 192, 195), CHROME)
        canvas.ellipse(middle, height - 0.01, 0.05, 0.045, (210, 212, 214), CHROME)
    else:
        height = body.belt[1] - 0.16
        canvas.line([(middle - 0.8 * half, 0.52), (middle + 0.8 * half, 0.52)], colour * 0.4, 0.02)
        canvas.line([(middle - 0.72 * half, height + 0.16), (middle + 0.72 * half, height + 0.16)],
                    colour * 0.35, 0.012)  # fmt: skip
        canvas.ellipse(middle, height + 0.06, 0.05, 0.05, (205, 207, 210), CHROME)
    for side in (-1, 1):
        outer, inner = middle + side * 0.97 * half, middle + side * 0.56 * half
        lower, upper = height - 0.08, height + 0.07
        shape = [(inner, lower + 0.03), (outer, lower), (outer, upper), (inner, upper - 0.03)]
        canvas.polygon(shape, *((CLEAR_LAMP, CHROME) if is_front else (RED_LAMP, PAINT)))
        bulb = 0.5 * (inner + outer)
        canvas.ellipse(bulb, height, 0.055, 0.05, (90, 95, 100) if is_front else (225, 90, 60))
        if not is_front:
            canvas.rectangle(min(inner, outer), lower + 0.02, abs(outer - inner), 0.03, AMBER_LAMP)


def _roof(body: Body, colour: np.ndarray) -> Canvas:
    """Bonnet, windscreen, roof, rear window and boot from above; the front is on the right."""
    canvas = Canvas(body.length + 0.4, body.width + 0.2, colour)
    centre, middle = canvas.size[0] / 2, canvas.size[1] / 2
    half = body.width / 2
    front, roof_front, roof_rear, rear = (centre + body.along(s) for s in body.cabin)
    canvas.polygon(
        [(front - 0.05, middle - 0.80 * half), (roof_front + 0.06, middle - 0.66 * half),
         (roof_front + 0.06, middle + 0.66 * half), (front - 0.05, middle + 0.80 * half)],
        TINT, GLASS,
    )  # fmt: skip
    canvas.rectangle(front - 0.05, middle - 0.8 * half, 0.07, 1.6 * half, BLACK, MATTE)
    if rear < roof_rear - 0.3:
        canvas.polygon(
            [(roof_rear - 0.06, middle - 0.66 * half), (rear + 0.06, middle - 0.78 * half),
             (rear + 0.06, middle + 0.78 * half), (roof_rear - 0.06, middle + 0.66 * half)],
            TINT, GLASS,
        )  # fmt: skip
    for side in (-1, 1):
        edge = middle + side * 0.86 * half
        canvas.line([(front + 0.02, edge), (canvas.size[0] - 0.25, middle + side * 0.7 * half)],
                    colour * 0.35, 0.012)  # fmt: skip
        if body.name in ("SUV", "wagon"):
            rail = middle + side * 0.60 * half
            canvas.line([(roof_front - 0.2, rail), (roof_rear + 0.2, rail)], BLACK, 0.04)
    return canvas


def _number_plate(canvas: Canvas, height: float, words: str, colour: Any) -> None:
    left = canvas.size[0] / 2 - 0.26
    canvas.rectangle(left - 0.012, height - 0.012, 0.544, 0.136, BLACK, MATTE)
    canvas.rectangle(left, height, 0.52, 0.112, colour, MATTE)
    canvas.rectangle(left, height, 0.045, 0.112, (25, 50, 140), MATTE)
    canvas.text(left + 0.06, height + 0.02, words, 0.072, (15, 15, 20))


def _sticker(canvas: Canvas, x: float, y: float, size: float, generator: Any) -> None:
    """A label of one of a few shapes with a word or a number on it."""
    first, second = generator.permutation(len(STICKERS))[:2]
    back, mark = STICKERS[first], STICKERS[second]
    if generator.random() < 0.5:
        canvas.ellipse(x + size / 2, y + size / 2, size / 2, size / 2, back, MATTE)
        canvas.ellipse(x + size / 2, y + size / 2, size / 4, size / 5, mark, MATTE)
    else:
        canvas.rectangle(x, y, size * 1.5, size, back, MATTE)
        words = "".join(generator.choice(list(LETTERS), 2))
        canvas.text(x + 0.1 * size, y + 0.2 * size, words, 0.6 * size, mark)


def _side_details(canvas: Canvas, body: Body, panel: float, generator: np.random.Generator) -> None:
    """Scratches and mud on each side, now and then a sticker; lettering on a van's panel."""
    width = canvas.size[0]
    for _ in range(generator.integers(1, 5)):
        x, y = generator.uniform(0.25, 0.75) * width, generator.uniform(0.35, 0.8)
        shade = generator.choice([40, 90, 170, 215])
        end = (x + generator.normal(0, 0.15), y + generator.normal(0, 0.03))
        canvas.line([(x, y), end], (shade, shade, shade), 0.012)
    for _ in range(generator.integers(0, 5)):
        x, y = generator.uniform(0.1, 0.9) * width, generator.uniform(0.3, 0.75)
        r = generator.uniform(0.02, 0.07)
        canvas.ellipse(x, y, r, 0.6 * r, (115, 100, 82), MATTE)
    if generator.random() < 0.35:
        x = generator.uniform(0.35, 0.6) * width
        _sticker(canvas, x, generator.uniform(0.45, 0.7), generator.uniform(0.08, 0.16), generator)
    if body.name == "van" and generator.random() < 0.8:
        colour = STICKERS[generator.integers(len(STICKERS))]
        words = "".join(generator.choice(list(LETTERS), 5))
        canvas.text(panel, 1.25, words, 0.26, colour)
        canvas.rectangle(panel, 1.12, 1.4, 0.05, colour)


def _windscreen_details(canvas: Canvas, body: Body, generator: np.random.Generator) -> None:
    """Permits behind the windscreen, things on the dashboard, two seats behind."""
    middle, low = canvas.size[0] / 2, body.belt[0] + 0.08
    for side in (-1, 1):
        canvas.rectangle(middle + side * 0.36 - 0.13, low + 0.1, 0.26, 0.14, (48, 52, 55))
        canvas.rectangle(middle + side * 0.36 - 0.08, low + 0.27, 0.16, 0.08, (48, 52, 55))
    canvas.rectangle(middle - 0.10, low + 0.36, 0.2, 0.05, (38, 40, 42))
    for _ in range(generator.integers(1, 4)):
        x = middle + generator.uniform(-0.6, 0.5)
        shade = generator.uniform(90, 245, 3)
        canvas.rectangle(x, low, generator.uniform(0.06, 0.2), generator.uniform(0.04, 0.1), shade)
    if generator.random() < 0.15:
        canvas.rectangle(middle - 0.62, low, 1.24, 0.3, (205, 208, 212), MATTE)


def _tail_details(canvas: Canvas, body: Body, generator: np.random.Generator) -> None:
    """Model badge, stickers on the boot and the rear window, a wiper."""
    middle, low = canvas.size[0] / 2, body.belt[1]
    canvas.text(middle + 0.30 * body.width / 2, low - 0.035, body.badge, 0.045, (200, 202, 205))
    if body.name not in ("sedan", "saloon"):
        canvas.line([(middle, low + 0.1), (middle + 0.35, low + 0.14)], BLACK, 0.025)
    for _ in range(generator.integers(0, 4)):
        x = middle + generator.uniform(-0.65, 0.4)
        y = low + generator.choice([-0.32, -0.2, 0.12, 0.2])
        _sticker(canvas, x, y, generator.uniform(0.07, 0.13), generator)


def _dirty(canvas: Canvas, amount: float, generator: np.random.Generator) -> None:
    """Dust that thickens towards the sills."""
    low = canvas.rgb[len(canvas.rgb) // 2 :]
    height = np.linspace(canvas.size[1] / 2, 0, len(low), dtype=np.float32)[:, None]
    noise = blotches(generator, low.shape[:2], 0.12 * canvas.density)
    film = (amount * np.clip(0.55 - height + 0.12 * noise, 0, 0.5))[..., None]
    dust = np.array([128, 116, 98], np.float32)
    low[:] = low + (dust - low) * film


def _rim(body: Body, generator: np.random.Generator) -> Canvas:
    """Tyre and rim; spokes by model, turned as the car happened to stop."""
    size = 2 * body.wheel
    canvas = Canvas(size, size, (22, 22, 23), MATTE, density=150)
    r, turn = body.wheel, generator.uniform(0, 2 * np.pi)
    silver = (168, 171, 174)
    canvas.ellipse(r, r, 0.70 * r, 0.70 * r, silver, CHROME)
    canvas.ellipse(r, r, 0.64 * r, 0.64 * r, (30, 30, 32), MATTE)
    for spoke in range(body.rim):
        angle = turn + 2 * np.pi * spoke / body.rim
        along, across = (
            np.array([np.cos(angle), np.sin(angle)]),
            np.array([-np.sin(angle), np.cos(angle)]),
        )
        thin = (0.12 if body.rim > 6 else 0.20) * r
        tip, root = r + 0.66 * r * along, r + 0.1 * r * along
        canvas.polygon(
            [root - thin * across / 2, tip - 0.7 * thin * across, tip + 0.7 * thin * across,
             root + thin * across / 2], silver, CHROME,
        )  # fmt: skip
    canvas.ellipse(r, r, 0.17 * r, 0.17 * r, (110, 112, 115), CHROME)
    return canvas
