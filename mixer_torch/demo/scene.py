"""The parking lot itself: which car stands where, the asphalt, what stands around, the light."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mixer_torch.demo.cars import BODIES, Body, car_mesh
from mixer_torch.demo.paint import paint_car
from mixer_torch.demo.rendering import Light, Mesh
from mixer_torch.demo.surroundings import panorama, surroundings
from mixer_torch.demo.textures import MATTE, Atlas, Canvas, blotches

BAY_WIDTH, BAY_DEPTH, AISLE = 2.5, 5.0, 6.4  # metres
GROUND_CELL = 0.04
MARGIN = 9.0  # of painted ground beyond the outer rows, metres
TWINS = 3
COLOURS = {
    "white": (236, 236, 232),
    "silver": (176, 179, 181),
    "grey": (104, 108, 112),
    "black": (24, 24, 27),
    "red": (158, 20, 24),
    "blue": (28, 58, 138),
    "green": (32, 92, 56),
    "orange": (214, 98, 22),
    "beige": (196, 180, 148),
    "yellow": (220, 180, 40),
}
SHARES = (0.22, 0.15, 0.13, 0.16, 0.11, 0.10, 0.04, 0.04, 0.03, 0.02)


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
class Ground:
    """The plane z = 0 as a texture.

    Args:
        table: As :class:`Atlas`, of the one texture.
        texels: As :class:`Atlas`.
        origin: (2,) world x and y of the texture's upper left corner.
        cell: Metres a texel.
        grain: Square tile of fine relative brightness.
    """

    table: np.ndarray
    texels: np.ndarray
    origin: np.ndarray
    cell: float
    grain: np.ndarray


@dataclass(frozen=True)
class Scene:
    """Everything that stands still: cars, triangles, textures, ground and light."""

    cars: tuple[ParkedCar, ...]
    mesh: Mesh
    atlas: Atlas
    ground: Ground
    light: Light


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
        end = self.half_size[0] - BAY_DEPTH / 2
        up, down = math.pi / 2, -math.pi / 2
        rows = [
            (x, y, facing)
            for y, facing in ((outer, down), (inner, up), (-inner, down), (-outer, up))
            for x in along
        ]
        ends = [(x, y, facing) for x, facing in ((-end, 0.0), (end, math.pi)) for y in across]
        return np.array(rows + ends)


def layout_for(num_cars: int) -> Layout:
    """The smallest lot with a few bays to spare."""
    return Layout(max(2, math.ceil((num_cars + 3 - 2 * Layout.end_bays) / 4)))


def build_scene(num_cars: int, sun_height: float, harshness: float, seed: int) -> Scene:
    """A lot from a seed.

    Args:
        num_cars: Number of parked cars.
        sun_height: Elevation of the sun, radians.
        harshness: Strength of the sun relative to the sky; 1 is a clear day.
        seed: Of every draw.
    """
    generator = np.random.default_rng([seed, 1])
    layout = layout_for(num_cars)
    cars = park(layout, num_cars, generator)
    meshes: list[Mesh] = []
    textures: list[np.ndarray] = []
    for number, car in enumerate(cars):
        meshes.append(_place(car, number, len(textures)))
        textures += paint_car(car.body, COLOURS[car.colour], generator)
    around, more = surroundings(layout.half_size, layout.places(), len(textures), generator)
    mesh = Mesh.join([*meshes, around])
    atlas = Atlas.pack(textures + more)
    ground = paint_ground(layout, cars, generator)
    return Scene(cars, mesh, atlas, ground, _light(mesh, atlas, sun_height, harshness, generator))


def park(layout: Layout, num_cars: int, generator: np.random.Generator) -> tuple[ParkedCar, ...]:
    """Cars in random bays, most nose first, none quite straight; a few are twins."""
    places = layout.places()
    bays = generator.permutation(len(places))[:num_cars]
    names = list(COLOURS)
    cars: list[ParkedCar] = []
    for bay in bays:
        body = BODIES[generator.choice(len(BODIES), p=[0.2, 0.14, 0.2, 0.12, 0.16, 0.12, 0.06])]
        colour = names[generator.choice(len(names), p=SHARES)]
        if 0 < len(cars) <= TWINS:
            body, colour = cars[0].body, cars[0].colour
        x, y, aisle = places[bay]
        heading = aisle + (math.pi if generator.random() < 0.55 else 0.0)
        offset = generator.normal(0, [0.12, 0.18])
        turned = heading + generator.normal(0, 0.025)
        cars.append(ParkedCar(body, colour, np.array([x, y]) + offset, turned))
    return tuple(cars[i] for i in generator.permutation(num_cars))


def _place(car: ParkedCar, number: int, first_tile: int) -> Mesh:
    """A car's mesh in the world."""
    mesh = car_mesh(car.body)
    cosine, sine = math.cos(car.heading), math.sin(car.heading)
    turn = np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])
    return Mesh(
        mesh.vertices @ turn + [*car.position, 0],
        mesh.normals @ turn,
        mesh.faces,
        mesh.uv,
        mesh.tile + first_tile,
        np.full(len(mesh.faces), number),
    )


def paint_ground(
    layout: Layout, cars: tuple[ParkedCar, ...], generator: np.random.Generator
) -> Ground:
    """Asphalt with repairs, stains and cracks, bay lines, arrows, and grass around."""
    import cv2

    half = layout.half_size + MARGIN
    canvas = Canvas(2 * half[0], 2 * half[1], (86, 98, 56), MATTE, 1 / GROUND_CELL)
    kerb = half - MARGIN + 0.6
    for wider, colour in ((0.2, (150, 148, 143)), (0.0, (84, 84, 86))):
        low, size = half - kerb - wider, 2 * (kerb + wider)
        canvas.rectangle(low[0], low[1], size[0], size[1], colour)
    _wear(canvas, half, kerb, generator)
    _markings(canvas, half, layout)
    for car in cars:
        _oil(canvas, half + car.position, generator)
    canvas.mottle(generator, 2.0, 0.06)
    canvas.mottle(generator, 0.3, 0.04)
    canvas.mottle(generator, GROUND_CELL, 0.07)
    canvas.rgb[:] = cv2.GaussianBlur(canvas.rgb, (3, 3), 0.6)
    atlas = Atlas.pack([canvas.texture()])
    fine = generator.standard_normal((256, 256)).astype(np.float32)
    grain = 0.17 * fine + 0.07 * blotches(generator, (256, 256), 4)
    return Ground(atlas.table, atlas.texels, half * [-1, 1], GROUND_CELL, grain)


def _wear(
    canvas: Canvas, half: np.ndarray, kerb: np.ndarray, generator: np.random.Generator
) -> None:
    """Patches of newer asphalt, cracks sealed with tar, drains."""
    for _ in range(14):
        x, y = half + generator.uniform(-kerb, kerb * 0.8)
        shade = generator.uniform(58, 100)
        size = generator.uniform(0.6, 3.5, 2)
        wide, deep = np.minimum(size, half + kerb - [x, y])
        canvas.rectangle(x, y, wide, deep, (shade, shade, shade + 2))
    for _ in range(45):
        path = [half + generator.uniform(-kerb, kerb)]
        heading = generator.uniform(0, 2 * np.pi)
        for _ in range(generator.integers(4, 14)):
            heading += generator.normal(0, 0.5)
            path.append(path[-1] + 0.4 * np.array([np.cos(heading), np.sin(heading)]))
        canvas.line(path, (42, 42, 44), 0.04)
    for _ in range(6):
        x, y = half + generator.uniform(-kerb, kerb)
        canvas.ellipse(x, y, 0.32, 0.32, (52, 50, 48))
        canvas.ellipse(x, y, 0.26, 0.26, (72, 70, 67))


def _markings(canvas: Canvas, half: np.ndarray, layout: Layout) -> None:
    """Lines between bays, their heads, and arrows in the aisles."""
    white = (205, 205, 200)
    for x, y, facing in layout.places():
        ahead = np.array([math.cos(facing), math.sin(facing)])
        left = np.array([-ahead[1], ahead[0]])
        for side in (-1, 1):
            edge = half + [x, y] + side * left * BAY_WIDTH / 2
            canvas.line([edge - ahead * BAY_DEPTH / 2, edge + ahead * BAY_DEPTH / 2], white, 0.12)
    canvas.rectangle(half[0] - layout.length / 2, half[1] - 0.06, layout.length, 0.12, white)
    for side in (-1, 1):
        for x in (-layout.length / 4, layout.length / 4):
            tip = half + np.array([x - side * 0.9, side * layout.aisle])
            canvas.rectangle(min(tip[0], tip[0] + side * 1.8), tip[1] - 0.08, 1.8, 0.16, white)
            head = np.array([[-side * 0.7, 0.0], [0.0, 0.35], [0.0, -0.35]])
            canvas.polygon(tip + head, white)


def _oil(canvas: Canvas, middle: np.ndarray, generator: np.random.Generator) -> None:
    """Oil and rust under and before a car, and a litter of leaves."""
    for _ in range(generator.integers(2, 6)):
        x, y = middle + generator.normal(0, [0.8, 2.2])
        shade = generator.uniform(45, 72)
        rx, ry = generator.uniform(0.05, 0.4, 2)
        canvas.ellipse(x, y, rx, ry, (shade, shade, shade))
    for _ in range(generator.integers(0, 14)):
        x, y = middle + generator.normal(0, [1.2, 2.5])
        leaf = generator.uniform(0.5, 1.2) * np.array([120, 92, 58])
        canvas.ellipse(x, y, 0.04, 0.04, leaf)


def _light(
    mesh: Mesh, atlas: Atlas, height: float, harshness: float, generator: np.random.Generator
) -> Light:
    """A warm low sun from a random side and a blue sky."""
    azimuth = generator.uniform(0, 2 * np.pi)
    level = math.cos(height)
    direction = np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(height)])
    sun = harshness * np.array([4.6, 4.1, 3.4])
    sky = np.array([0.30, 0.38, 0.54])
    return Light.cast(
        mesh,
        atlas,
        direction,
        sun=sun,
        sky=sky,
        bounce=0.10 * (sun * math.sin(height) + sky),
        panorama=panorama(direction, harshness, generator),
    )
