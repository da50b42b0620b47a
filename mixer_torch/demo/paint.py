"""What is painted on a car: windows, lamps, doors, number plates, stickers and dirt."""

from __future__ import annotations

from typing import Any

import numpy as np

from mixer_torch.demo.cars import DRAWN_HEIGHT, SPARE, Body
from mixer_torch.demo.textures import CHROME, GLASS, MATTE, PAINT, Canvas, smooth_noise

BLACK = (16, 16, 17)
STEEL = ((168, 171, 174), CHROME)
PANE = ((24, 30, 33), GLASS)
SILL = ((28, 28, 29), MATTE)
LAMP, TAIL_LAMP = ((215, 222, 226), CHROME), ((150, 16, 14), PAINT)
FRONT_SHAPES = (  # trapezoids: their lower and upper edge, half widths (1 is the car's), ink
    (("ground", 0.0), ("sill", 0.16), 1.2, 1.2, SILL),
    (("belt", 0.06), ("roof", -0.10), 0.80, 0.66, PANE),
    (("bonnet", -0.18), ("bonnet", -0.04), 0.97, 0.97, LAMP),
    (("bonnet", -0.18), ("bonnet", -0.04), 0.58, 0.58, None),  # in the colour of the car
    (("bonnet", -0.17), ("bonnet", -0.06), 0.45, 0.45, (BLACK, MATTE)),
    (("ground", 0.33), ("ground", 0.49), 0.50, 0.50, (BLACK, MATTE)),
)
BACK_SHAPES = (
    (("ground", 0.0), ("sill", 0.16), 1.2, 1.2, SILL),
    (("boot", 0.08), ("roof", -0.10), 0.80, 0.66, PANE),
    (("boot", -0.24), ("boot", -0.09), 0.97, 0.97, TAIL_LAMP),
    (("boot", -0.24), ("boot", -0.09), 0.58, 0.58, None),
    (("boot", -0.13), ("boot", -0.07), 0.06, 0.06, STEEL),
    (("ground", 0.51), ("ground", 0.53), 0.80, 0.80, (BLACK, MATTE)),
)
SEAM = 0.014  # width of the gap around a door, metres
LETTERS = list("ABCDEFGHJKLMNPRSTUVWXYZ")
VIVID = ((225, 40, 45), (35, 85, 200), (245, 205, 40), (40, 150, 75), (240, 240, 240), (20, 20, 20))
DUST = (115, 100, 82)
STICKER = ((0.10, 0.10), (0.30, 0.20), VIVID, 2)  # marks: least and greatest size, colours, letters
PERMIT = ((0.06, 0.04), (0.20, 0.10), VIVID, 0)
SCRATCH = ((0.05, 0.01), (0.30, 0.02), ((40, 40, 40), (170, 170, 170)), 0)
MUD = ((0.04, 0.02), (0.14, 0.08), (DUST,), 0)
LETTERING = ((1.2, 0.26), (1.4, 0.32), VIVID, 5)


def paint_car(body: Body, colour: Any, generator: np.random.Generator) -> list[np.ndarray]:
    """The textures of one car, in the order of cars.TEXTURES.

    What the model and the colour leave open (plate, stickers, dirt, what lies in the windows) is
    drawn from the generator, so that two of the same model and colour are twins, not copies.
    """
    colour = np.asarray(colour, float)
    plate = _word(generator, 2) + f" {generator.integers(10, 99)} " + _word(generator, 2)
    right, left = _side(body, colour), _side(body, colour)
    left.texture[:] = left.texture[:, ::-1].copy()
    front, back = _face(body, colour, FRONT_SHAPES), _face(body, colour, BACK_SHAPES)
    top = _top(body, colour)
    length, middle, (belt, boot) = body.length, front.size[0] / 2, body.belt
    for side, panel in ((right, 0.14 * length), (left, 0.55 * length)):
        low, high = (0.25 * length, 0.35), (0.75 * length, 0.75)
        for kind, least, most in ((SCRATCH, 1, 4), (MUD, 0, 4), (STICKER, 0, 3)):
            count = int(generator.integers(least, most + 1))
            _marks(side, low, high, kind, count, generator)
        if body.name == "van":
            _marks(side, (panel, 1.2), (panel, 1.3), LETTERING, 1, generator)
    for canvas, height, paper in ((front, 0.42, (238, 238, 232)), (back, 0.7, (236, 205, 70))):
        canvas.rectangle(middle - 0.27, height - 0.01, 0.54, 0.13, BLACK, MATTE)
        canvas.rectangle(middle - 0.26, height, 0.52, 0.11, paper, MATTE)
        canvas.text(middle - 0.2, height + 0.02, plate, 0.072, BLACK)
    for bar in range(body.spokes % 3 + 1):  # models differ in their grilles and badges
        x, y = 0.215 * body.width, body.top(0.03) - 0.16 + 0.04 * bar
        front.rectangle(middle - x, y, 2 * x, 0.012, *STEEL)
    back.text(middle + 0.15 * body.width, boot - 0.035, body.name.upper(), 0.045, STEEL[0])
    windscreen = (middle - 0.6, belt + 0.08), (middle + 0.5, belt + 0.1)
    _marks(front, *windscreen, PERMIT, int(generator.integers(1, 4)), generator)
    tail = (middle - 0.65, boot - 0.32), (middle + 0.4, boot + 0.2)
    _marks(back, *tail, STICKER, int(generator.integers(1, 5)), generator)
    dirt = generator.uniform(0.2, 1.0)
    for canvas in (right, left, front, back):
        canvas.mottle(generator, 0.5, 0.025)
        _dirty(canvas, dirt, generator)
    top.mottle(generator, 0.25, 0.02 + 0.04 * dirt)
    return [part.texture for part in (right, left, front, back, top, _rim(body, generator))]


def _word(generator: np.random.Generator, length: int) -> str:
    return "".join(generator.choice(LETTERS, length))


def _side(body: Body, colour: np.ndarray) -> Canvas:
    """The right side: the car's front is on the right of the texture."""
    canvas = Canvas(body.length + SPARE, DRAWN_HEIGHT, colour)
    pillar = 0.5 * (body.cabin[1] + body.cabin[2]) - 0.02
    pillars = [pillar, pillar + 0.23]

    def at(station: Any) -> Any:
        return canvas.size[0] / 2 + body.along(station)

    sill = body.clearance + 0.13
    canvas.rectangle(0, 0, canvas.size[0], sill, *SILL)
    stations = np.linspace(body.cabin[0] + 0.035, body.cabin[3] - 0.02, 60)
    low, rise = body.shoulder(stations), body.top(stations) - body.shoulder(stations)
    high = 0.80 * rise > 0.08  # where there is room for a window
    lower = np.stack([at(stations), low + 0.02], 1)[high]
    upper = np.stack([at(stations), low + 0.80 * rise - 0.01], 1)[high]
    window = np.concatenate([lower, upper[::-1]])
    canvas.polygon(window, *PANE)
    if body.name == "van":
        canvas.rectangle(at(0.93), body.belt[0], 0.45 * body.length, 0.75, colour)
    canvas.line(window, BLACK, 0.03)
    for station in pillars:
        x, low = at(station), body.shoulder(station)
        canvas.rectangle(x - 0.05, low, 0.1, 0.9 * (body.top(station) - low), BLACK, MATTE)
        canvas.rectangle(x + 0.06, 0.83 * body.belt[0], 0.19, 0.035, colour * 0.6, CHROME)  # handle
    for station in (body.cabin[0] + 0.035, *pillars):  # doors
        x = at(min(station, body.axles[1] - 0.06))
        canvas.line([(x, sill), (x, body.shoulder(station))], colour * 0.3, SEAM)
    for station in body.axles:
        canvas.ellipse(at(station), body.wheel, body.wheel * 1.17, body.wheel * 1.17, BLACK, MATTE)
    canvas.rectangle(at(0.06), body.top(0.06) - 0.15, 0.3, 0.13, *LAMP)
    canvas.rectangle(0, body.belt[1] - 0.24, at(0.955), 0.18, *TAIL_LAMP)
    return canvas


def _face(body: Body, colour: np.ndarray, shapes: Any) -> Canvas:
    """Front or back, from FRONT_SHAPES or BACK_SHAPES."""
    canvas = Canvas(body.width + SPARE, DRAWN_HEIGHT, colour, density=150)
    heights = {"ground": 0.0, "sill": body.clearance, "belt": body.belt[0], "boot": body.belt[1],
               "bonnet": body.top(0.03), "roof": body.top(0.55)}  # fmt: skip
    for lower, upper, low_width, high_width, ink in shapes:
        x = np.array([-low_width, low_width, high_width, -high_width]) * body.width / 2
        low, high = (heights[reference] + offset for reference, offset in (lower, upper))
        corners = np.stack([canvas.size[0] / 2 + x, [low, low, high, high]], axis=1)
        canvas.polygon(corners, *(ink or (colour, PAINT)))
    return canvas


def _top(body: Body, colour: np.ndarray) -> Canvas:
    """Bonnet, windscreen, roof, rear window and boot from above; the front is on the right."""
    canvas = Canvas(body.length + SPARE, body.width + SPARE, colour)
    middle, half = canvas.size[1] / 2, body.width / 2
    front, roof_front, roof_rear, rear = canvas.size[0] / 2 + body.along(body.cabin)
    panes = [(front - 0.05, 0.80, roof_front + 0.06), (rear + 0.06, 0.78, roof_rear - 0.06)]
    for foot, wide, head in panes if rear < roof_rear - 0.3 else panes[:1]:
        canvas.polygon(
            [(foot, middle - wide * half), (head, middle - 0.66 * half),
             (head, middle + 0.66 * half), (foot, middle + wide * half)], *PANE,
        )  # fmt: skip
    return canvas


def _marks(
    canvas: Canvas, low: Any, high: Any, kind: Any, count: int, generator: np.random.Generator
) -> None:
    """A count of marks of a kind, with their lower left corners between two."""
    least, greatest, colours, letters = kind
    for _ in range(count):
        (x, y), (wide, tall) = generator.uniform(low, high), generator.uniform(least, greatest)
        colour, ink = np.array(colours)[generator.permutation(len(colours))[[0, -1]]]
        canvas.rectangle(x, y, wide, tall, colour, MATTE)
        if letters:
            canvas.text(x, y + 0.2 * tall, _word(generator, letters), 0.6 * tall, ink)


def _dirty(canvas: Canvas, amount: float, generator: np.random.Generator) -> None:
    """Dust that thickens towards the sills."""
    low = canvas.texture[len(canvas.texture) // 2 :, :, :3]
    height = np.linspace(canvas.size[1] / 2, 0, len(low), dtype=np.float32)[:, None]
    noise = smooth_noise(generator, low.shape[:2], 0.12 * canvas.density)
    film = (amount * np.clip(0.55 - height + 0.12 * noise, 0, 0.5))[..., None]
    low[:] = low + (np.array(DUST, np.float32) - low) * film


def _rim(body: Body, generator: np.random.Generator) -> Canvas:
    """Tyre and rim; spokes by model, turned as the car happened to stop."""
    r = body.wheel
    canvas = Canvas(2 * r, 2 * r, (22, 22, 23), MATTE, density=150)
    canvas.ellipse(r, r, 0.70 * r, 0.70 * r, *STEEL)
    canvas.ellipse(r, r, 0.64 * r, 0.64 * r, (30, 30, 32), MATTE)
    pitch = 2 * np.pi / body.spokes
    middles = generator.uniform(0, 2 * np.pi) + pitch * np.arange(body.spokes)
    for angle in middles[:, None] + pitch * np.array([-0.15, -0.25, 0.25, 0.15]):
        spoke = np.stack([np.cos(angle), np.sin(angle)], 1) * [[0.1], [0.66], [0.66], [0.1]]
        canvas.polygon(r + r * spoke, *STEEL)
    canvas.ellipse(r, r, 0.17 * r, 0.17 * r, (110, 112, 115), CHROME)
    return canvas
