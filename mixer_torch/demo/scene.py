"""The parking lot itself: which car stands where, the asphalt, what stands around, the light."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mixer_torch.demo.cars import BODIES, TEXTURES, Body, car_mesh
from mixer_torch.demo.kernels import GROUND, GROUND_CELL
from mixer_torch.demo.paint import paint_car
from mixer_torch.demo.rendering import Light, Mesh
from mixer_torch.demo.surroundings import panorama, surroundings
from mixer_torch.demo.textures import MATTE, Atlas, Canvas, smooth_noise

BAY_WIDTH, BAY_DEPTH, AISLE = 2.5, 5.0, 6.4  # metres
MARGIN = 9.0  # of painted ground beyond the outer rows, metres
SUN_HEIGHT = math.radians(36)
TWINS = 3  # cars beside the first that are of its model and colour
LINES = (205, 205, 200)
COLOURS = {  # of cars, and the share of cars that have them
    "white": (236, 236, 232, 0.22),
    "silver": (176, 179, 181, 0.15),
    "grey": (104, 108, 112, 0.13),
    "black": (24, 24, 27, 0.16),
    "red": (158, 20, 24, 0.11),
    "blue": (28, 58, 138, 0.10),
    "green": (32, 92, 56, 0.04),
    "orange": (214, 98, 22, 0.04),
    "beige": (196, 180, 148, 0.03),
    "yellow": (220, 180, 40, 0.02),
}


@dataclass(frozen=True)
class ParkedCar:
    """A car in its bay.

    Args:
        body: Model.
        colour: Name of its paint.
        position: (2,) its centre on the ground, metres.
        heading: Direction its front points to, radians from the x axis.
    """

    body: Body
    colour: str
    position: np.ndarray
    heading: float


@dataclass(frozen=True)
class Scene:
    """Everything that stands still: cars, triangles, textures, light, the asphalt's grain."""

    cars: tuple[ParkedCar, ...]
    mesh: Mesh
    atlas: Atlas
    light: Light
    grain: np.ndarray


@dataclass(frozen=True)
class Layout:
    """Two rows of bays back to back along the x axis, a loop of aisles around, bays beyond.

    Args:
        bays: Number of bays in each of the four rows along x.
        end_bays: Number of bays in each of the two rows along y, beyond the loop's ends.
    """

    bays: int
    end_bays: int = 8

    @property
    def length(self) -> float:
        """Of a row along x, metres."""
        return self.bays * BAY_WIDTH

    @property
    def aisle(self) -> float:
        """Distance of the long aisles' middle lines from the x axis."""
        return BAY_DEPTH + AISLE / 2

    @property
    def half_size(self) -> np.ndarray:
        """(2,) distances of the outer bays' far edges from the middle, along x and y."""
        return np.array([self.length / 2 + AISLE + BAY_DEPTH, 2 * BAY_DEPTH + AISLE])

    def places(self) -> np.ndarray:
        """(n, 3) x and y of each bay's middle, and the direction towards its aisle."""
        along = (np.arange(self.bays) - (self.bays - 1) / 2) * BAY_WIDTH
        across = (np.arange(self.end_bays) - (self.end_bays - 1) / 2) * BAY_WIDTH
        inner, outer = BAY_DEPTH / 2, 1.5 * BAY_DEPTH + AISLE
        end, up, down = self.half_size[0] - BAY_DEPTH / 2, math.pi / 2, -math.pi / 2
        rows = ((outer, down), (inner, up), (-inner, down), (-outer, up))
        places = [(x, y, facing) for y, facing in rows for x in along]
        places += [(x, y, facing) for x, facing in ((-end, 0.0), (end, math.pi)) for y in across]
        return np.array(places)


def layout_for(num_cars: int) -> Layout:
    """The smallest lot with a few bays to spare."""
    return Layout(max(2, math.ceil((num_cars + 3 - 2 * Layout.end_bays) / 4)))


def build_scene(num_cars: int, harshness: float, seed: int) -> Scene:
    """A lot from a seed.

    Args:
        num_cars: Number of parked cars.
        harshness: Strength of the sun relative to the sky; 1 is a clear day.
        seed: Of every draw.
    """
    generator = np.random.default_rng([seed, 1])
    layout = layout_for(num_cars)
    cars = park(layout, num_cars, generator)
    meshes, textures = [_ground(layout)], [_paint_ground(layout, cars, generator)]
    for number, car in enumerate(cars):
        meshes.append(_placed(car, car_mesh(car.body, number, 1 + number * len(TEXTURES))))
        textures += paint_car(car.body, COLOURS[car.colour][:3], generator)
    around, more = surroundings(layout.half_size, len(textures), generator)
    mesh, atlas = Mesh.join(meshes + around), Atlas.pack(textures + more)
    grain = 0.17 * smooth_noise(generator, (256, 256), 1)
    grain += 0.07 * smooth_noise(generator, (256, 256), 4)
    return Scene(cars, mesh, atlas, _light(mesh, atlas, harshness, generator), grain)


def park(layout: Layout, num_cars: int, generator: np.random.Generator) -> tuple[ParkedCar, ...]:
    """Cars in random bays, most nose first, none quite straight; a few are twins."""
    places, names = layout.places(), list(COLOURS)
    shares = [body.share for body in BODIES], [share for *_, share in COLOURS.values()]
    cars: list[ParkedCar] = []
    for x, y, aisle in places[generator.permutation(len(places))[:num_cars]]:
        body = BODIES[generator.choice(len(BODIES), p=shares[0])]
        colour = names[generator.choice(len(names), p=shares[1])]
        if 0 < len(cars) <= TWINS:
            body, colour = cars[0].body, cars[0].colour
        heading = aisle + (math.pi if generator.random() < 0.55 else 0.0)
        position = np.array([x, y]) + generator.normal(0, [0.12, 0.18])
        cars.append(ParkedCar(body, colour, position, heading + generator.normal(0, 0.025)))
    return tuple(cars[i] for i in generator.permutation(num_cars))


def _placed(car: ParkedCar, mesh: Mesh) -> Mesh:
    """A car's mesh in the world."""
    cosine, sine = math.cos(car.heading), math.sin(car.heading)
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    vertices = mesh.vertices @ turn + [*car.position, 0]
    return replace(mesh, vertices=vertices, normals=mesh.normals @ turn)


def _ground(layout: Layout) -> Mesh:
    """The plane z = 0 in squares of a metre, as triangles are not clipped."""
    half = layout.half_size + MARGIN
    y, x = (np.linspace(-side, side, math.ceil(2 * side) + 1) for side in half[::-1])
    v, u = np.meshgrid(0.5 - y / half[1] / 2, 0.5 + x / half[0] / 2, indexing="ij")
    points = np.dstack([*np.meshgrid(x, y), np.zeros_like(u)])[::-1]
    return Mesh.grid(points, np.dstack([u, v])[::-1], 0, GROUND)


def _paint_ground(
    layout: Layout, cars: tuple[ParkedCar, ...], generator: np.random.Generator
) -> np.ndarray:
    """Asphalt with repairs, cracks and stains, a kerb and grass around, bay lines and arrows."""
    half = layout.half_size + MARGIN
    canvas = Canvas(2 * half[0], 2 * half[1], (86, 98, 56), MATTE, 1 / GROUND_CELL)
    kerb = half - MARGIN + 0.6
    for wider, colour in ((0.2, (150, 148, 143)), (0.0, (84, 84, 86))):
        x, y = half - kerb - wider
        canvas.rectangle(x, y, 2 * (kerb[0] + wider), 2 * (kerb[1] + wider), colour)
    for _ in range(14):  # newer asphalt
        x, y = corner = half + generator.uniform(-kerb, kerb * 0.8)
        wide, deep = np.minimum(generator.uniform(0.6, 3.5, 2), half + kerb - corner)
        canvas.rectangle(x, y, wide, deep, np.full(3, generator.uniform(58, 100)))
    for _ in range(45):  # cracks sealed with tar
        turns = generator.normal(0, 0.5, generator.integers(4, 14))
        heading = generator.uniform(0, 2 * np.pi) + np.cumsum(turns)
        steps = 0.4 * np.stack([np.cos(heading), np.sin(heading)], 1)
        canvas.line(half + generator.uniform(-kerb, kerb) + np.cumsum(steps, 0), (42, 42, 44), 0.04)
    _markings(canvas, half, layout)
    for car in cars:  # oil under and before them
        for _ in range(generator.integers(2, 6)):
            x, y = half + car.position + generator.normal(0, [0.8, 2.2])
            shade = np.full(3, generator.uniform(45, 72))
            wide, deep = generator.uniform(0.05, 0.4, 2)
            canvas.ellipse(x, y, wide, deep, shade)
    for cell, strength in ((2.0, 0.06), (0.3, 0.04), (GROUND_CELL, 0.07)):
        canvas.mottle(generator, cell, strength)
    return canvas.texture


def _markings(canvas: Canvas, half: np.ndarray, layout: Layout) -> None:
    """Lines between bays, their heads, and arrows in the aisles."""
    for x, y, facing in layout.places():
        ahead = BAY_DEPTH / 2 * np.array([math.cos(facing), math.sin(facing)])
        left = BAY_WIDTH / 2 * np.array([-math.sin(facing), math.cos(facing)])
        for across in (left, -left):
            edge = half + np.array([x, y]) + across
            canvas.line([edge - ahead, edge + ahead], LINES, 0.12)
    canvas.rectangle(half[0] - layout.length / 2, half[1] - 0.06, layout.length, 0.12, LINES)
    for side in (-1, 1):
        for x in (-layout.length / 4, layout.length / 4):
            tip = half + np.array([x - side * 0.9, side * layout.aisle])
            canvas.line(tip + np.array([[0, 0], [side * 1.8, 0]]), LINES, 0.16)
            canvas.polygon(tip + np.array([[-side * 0.7, 0], [0, 0.35], [0, -0.35]]), LINES)


def _light(mesh: Mesh, atlas: Atlas, harshness: float, generator: np.random.Generator) -> Light:
    """A warm low sun from a random side and a blue sky."""
    azimuth = generator.uniform(0, math.tau)
    level, height = math.cos(SUN_HEIGHT), math.sin(SUN_HEIGHT)
    direction = np.array([level * math.cos(azimuth), level * math.sin(azimuth), height])
    sun, sky = harshness * np.array([4.6, 4.1, 3.4]), np.array([0.30, 0.38, 0.54])
    colours = np.stack([direction, sun, sky, 0.10 * (sun * height + sky)])
    return Light.cast(mesh, atlas, colours, panorama(direction, harshness, generator))
