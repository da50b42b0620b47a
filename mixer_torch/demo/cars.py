"""Cars of the parking lot: body styles, and their surfaces as lofts of cross-sections."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from mixer_torch.demo.rendering import Mesh

LEFT, RIGHT, FRONT, BACK, TOP, RIM, DARK = range(7)
TEXTURES = 7  # a car's textures, in the order above
DRAWN_HEIGHT = 2.1  # metres that the textures of the sides, the front and the back cover
SPOKES = 16  # corners of a wheel


@dataclass(frozen=True)
class Body:
    """A car model. Metres; stations are fractions of the length, from the front bumper.

    Args:
        name: Body style.
        length: From bumper to bumper.
        width: Without mirrors.
        profile: Rows of station and height along the roof line, from 0 to 1.
        cabin: Stations of the windscreen's foot, the roof's front and rear, the rear window's foot.
        belt: Heights of the windows' lower edge at the windscreen and at the rear.
        axles: Stations of the wheels.
        wheel: Radius of a wheel.
        clearance: Height of the sill.
        rim: Number of spokes.
        badge: Letters on the tail.
    """

    name: str
    length: float
    width: float
    profile: tuple[tuple[float, float], ...]
    cabin: tuple[float, float, float, float]
    belt: tuple[float, float]
    axles: tuple[float, float]
    wheel: float
    clearance: float
    rim: int
    badge: str

    def top(self, station: Any) -> Any:
        """Height of the roof line at stations."""
        knots = np.array(self.profile)
        return PchipInterpolator(knots[:, 0], knots[:, 1])(np.clip(station, 0, 1))

    def shoulder(self, station: Any) -> Any:
        """Height at which the side ends and glass, bonnet or boot begin."""
        front, _, _, rear = self.cabin
        belt = np.interp(station, [front, rear], self.belt)
        return np.minimum(self.top(station) - 0.03, belt)

    def half_width(self, station: Any) -> Any:
        """Half the width in plan, rounded towards both ends."""
        end = np.abs(2 * np.asarray(station) - 1)
        return self.width / 2 * (1 - 0.05 * end**4 - 0.10 * end**16)

    def along(self, station: float) -> float:
        """Coordinate, positive to the front, of a station."""
        return self.length * (0.5 - station)


BODIES = (
    Body("sedan", 4.62, 1.82, ((0.0, 0.58), (0.02, 0.68), (0.1, 0.80), (0.28, 0.97), (0.46, 1.38),
         (0.57, 1.45), (0.70, 1.40), (0.86, 1.08), (0.97, 1.03), (1.0, 0.88)),
         (0.28, 0.455, 0.70, 0.865), (0.93, 0.99), (0.19, 0.80), 0.325, 0.20, 5, "LYRA 2.0"),
    Body("saloon", 4.90, 1.86, ((0.0, 0.60), (0.02, 0.72), (0.1, 0.84), (0.31, 0.99), (0.47, 1.40),
         (0.56, 1.47), (0.67, 1.43), (0.82, 1.13), (0.97, 1.08), (1.0, 0.90)),
         (0.31, 0.47, 0.675, 0.825), (0.95, 1.03), (0.18, 0.79), 0.345, 0.19, 10, "VEGA S"),
    Body("hatchback", 4.05, 1.75, ((0.0, 0.56), (0.02, 0.70), (0.1, 0.84), (0.25, 0.99),
         (0.44, 1.43), (0.58, 1.49), (0.84, 1.43), (0.955, 1.02), (1.0, 0.72)),
         (0.25, 0.44, 0.85, 0.955), (0.94, 1.02), (0.19, 0.82), 0.31, 0.20, 7, "MIKA"),
    Body("compact", 3.62, 1.64, ((0.0, 0.60), (0.03, 0.76), (0.12, 0.90), (0.22, 1.00),
         (0.42, 1.47), (0.58, 1.53), (0.87, 1.46), (0.965, 1.02), (1.0, 0.74)),
         (0.22, 0.42, 0.88, 0.965), (0.93, 1.00), (0.17, 0.83), 0.29, 0.19, 4, "PIP"),
    Body("SUV", 4.52, 1.86, ((0.0, 0.66), (0.02, 0.88), (0.1, 1.00), (0.25, 1.10), (0.40, 1.57),
         (0.55, 1.67), (0.85, 1.61), (0.965, 1.16), (1.0, 0.82)),
         (0.25, 0.405, 0.86, 0.965), (1.05, 1.13), (0.19, 0.81), 0.365, 0.27, 6, "TERRA 4X4"),
    Body("wagon", 4.70, 1.82, ((0.0, 0.57), (0.02, 0.68), (0.1, 0.80), (0.27, 0.97), (0.44, 1.40),
         (0.55, 1.47), (0.87, 1.41), (0.965, 1.04), (1.0, 0.74)),
         (0.27, 0.44, 0.88, 0.965), (0.93, 1.01), (0.19, 0.79), 0.325, 0.20, 8, "LYRA KOMBI"),
    Body("van", 4.85, 1.92, ((0.0, 0.66), (0.02, 0.86), (0.1, 1.03), (0.17, 1.13), (0.33, 1.80),
         (0.45, 1.92), (0.93, 1.90), (0.985, 1.15), (1.0, 0.80)),
         (0.17, 0.325, 0.95, 0.985), (1.06, 1.10), (0.18, 0.80), 0.335, 0.22, 9, "CARGO"),
)  # fmt: skip


def car_mesh(body: Body) -> Mesh:
    """A car at the origin, its front towards +x, with tiles LEFT to DARK and owner 0."""
    rings = _rings(body)
    parts = [_grid(rings, body, False)]
    for ring, forward in ((rings[0], True), (rings[-1], False)):
        parts.append(_grid(_cap(ring, forward), body, True))
    for station in body.axles:
        for side in (1.0, -1.0):
            parts.append(_wheel(body, station, side))
    for side in (1.0, -1.0):
        parts.append(_mirror(body, side))
    return Mesh.join(parts)


def _rings(body: Body) -> np.ndarray:
    """(stations, points, 3) cross-sections, front to rear, from the left sill over the roof."""
    knots = [0, 0.008, 0.02, 0.045, 0.08, 0.92, 0.955, 0.98, 0.992, 1, *body.cabin, *body.axles]
    stations = np.unique(np.round(np.concatenate([knots, np.linspace(0.12, 0.88, 15)]), 4))
    top, shoulder, half = body.top(stations), body.shoulder(stations), body.half_width(stations)
    end = np.abs(2 * stations - 1)
    sill = body.clearance + 0.10 * end**24
    middle = 0.55 * shoulder + 0.45 * sill
    rise = top - shoulder
    cabin = np.clip(rise / (max(body.top(np.array([0.5]))[0] - body.belt[0], 0.1)), 0, 1)
    roof = half * (0.93 - 0.19 * cabin)
    heights = [sill, sill + 0.07, middle, shoulder - 0.05, shoulder, shoulder + 0.86 * rise,
               shoulder + 0.97 * rise, top]  # fmt: skip
    widths = [
        0.90 * half,
        0.985 * half,
        half,
        0.975 * half,
        0.93 * half,
        roof,
        0.80 * roof,
        0 * half,
    ]
    left = np.stack([np.stack(widths, 1), np.stack(heights, 1)], axis=2)
    right = left[:, -2::-1] * [-1, 1]
    section = np.concatenate([left, right], axis=1)
    along = (body.length * (0.5 - stations))[:, None] * np.ones(section.shape[1])
    bend = np.sign(along) * 0.16 * (section[..., 0] / (body.width / 2)) ** 2 * end[:, None] ** 8
    return np.concatenate([(along - bend)[..., None], section], axis=2)


def _cap(ring: np.ndarray, forward: bool) -> np.ndarray:
    """The bumper face: the end ring's left and right halves joined by rows, bulging outwards."""
    count = len(ring) // 2
    left, right = ring[:count], ring[: -count - 1 : -1]
    across = np.linspace(0, 1, 7)[:, None, None]
    cap = left * (1 - across) + right * across
    bulge = 1 - (2 * across[..., 0] - 1) ** 2
    cap[..., 0] += (1 if forward else -1) * 0.14 * bulge
    return cap if forward else cap[:, ::-1]


def _grid(points: np.ndarray, body: Body, is_cap: bool) -> Mesh:
    """A grid of points as triangles: smooth normals, and a texture by where a quad faces."""
    rows, columns = points.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    quads = np.stack([a, b, c, d], axis=-1).reshape(-1, 4)
    vertices = points.reshape(-1, 3)
    facing = np.cross(
        vertices[quads[:, 2]] - vertices[quads[:, 0]], vertices[quads[:, 3]] - vertices[quads[:, 1]]
    )
    out = vertices[quads].mean(1) - [0, 0, 0.6]
    outwards = (facing * out).sum() > 0
    facing = facing if outwards else -facing
    normals = np.zeros_like(vertices)
    for corner in range(4):
        np.add.at(normals, quads[:, corner], facing)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    weight = np.abs(facing) * ([1.0, 0.5, 0.6] if is_cap else [0.75, 1.0, 0.9])
    axis = weight.argmax(1)
    tile = np.select(
        [axis == 0, axis == 1],
        [np.where(facing[:, 0] > 0, FRONT, BACK), np.where(facing[:, 1] > 0, LEFT, RIGHT)],
        TOP,
    )
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    tile = np.concatenate([tile, tile])
    uv = texture_coordinates(vertices[faces], tile[:, None], body)
    return Mesh(vertices, normals, faces, uv, tile, np.zeros(len(faces), np.int64))


def texture_coordinates(points: np.ndarray, tile: np.ndarray, body: Body) -> np.ndarray:
    """(..., 2) where a car's points (..., 3) lie on the textures they are projected to."""
    x, y, z = np.moveaxis(points, -1, 0)
    along, across = x / (body.length + 0.4), y / (body.width + 0.2)
    choices = [tile == LEFT, tile == RIGHT, tile == FRONT, tile == BACK]
    u = np.select(choices, [0.5 - along, 0.5 + along, 0.5 + across, 0.5 - across], 0.5 + along)
    v = np.where(tile == TOP, 0.5 - across, 1 - z / DRAWN_HEIGHT)
    return np.stack([u, v], axis=-1)


def _wheel(body: Body, station: float, side: float) -> Mesh:
    """A disc with the rim, and the tread behind it."""
    turn = np.linspace(0, 2 * np.pi, SPOKES, endpoint=False)
    ring = np.stack([body.along(station) + body.wheel * np.cos(turn), np.zeros(SPOKES),
                     body.wheel * (1 + np.sin(turn))], axis=1)  # fmt: skip
    outside = side * (body.width / 2 + 0.004)
    centre = np.array([[body.along(station), outside, body.wheel]])
    outer = ring + np.array([0, outside, 0])
    inner = outer - np.array([0, side * 0.22, 0])
    vertices = np.concatenate([centre, outer, outer, inner])
    radial = (ring - centre * [1, 0, 1]) / body.wheel
    flat = np.tile([0, side, 0], (SPOKES + 1, 1))
    normals = np.concatenate([flat, radial, radial])
    k = np.arange(SPOKES)
    n = (k + 1) % SPOKES
    disc = np.stack([0 * k, 1 + k, 1 + n], axis=1)
    tread = [np.stack([1 + SPOKES + k, 1 + SPOKES + n, 1 + 2 * SPOKES + n], 1),
             np.stack([1 + SPOKES + k, 1 + 2 * SPOKES + n, 1 + 2 * SPOKES + k], 1)]  # fmt: skip
    faces = np.concatenate([disc, *tread])
    turned = np.concatenate([[[0.5, 0.5]], np.stack([np.cos(turn), np.sin(turn)], 1) / 2 + 0.5])
    uv = np.full((len(faces), 3, 2), 0.5)
    uv[:SPOKES] = turned[disc]
    tile = np.where(np.arange(len(faces)) < SPOKES, RIM, DARK)
    return Mesh(vertices, normals, faces, uv, tile, np.zeros(len(faces), np.int64))


def _mirror(body: Body, side: float) -> Mesh:
    """A door mirror: a small ellipsoid beside the windscreen's foot."""
    turn, lift = np.meshgrid(np.linspace(0, 2 * np.pi, 9), np.linspace(-1.5, 1.5, 5))
    ball = np.stack([np.cos(lift) * np.cos(turn), np.cos(lift) * np.sin(turn), np.sin(lift)], 2)
    at = [body.along(body.cabin[0] + 0.07), side * (body.width / 2 + 0.05), body.belt[0] + 0.08]
    mesh = _grid(ball, body, False)
    vertices = mesh.vertices * [0.07, 0.12, 0.085] + at
    tile = np.where(mesh.tile == BACK, DARK, TOP)
    uv = np.broadcast_to([0.06, 0.5], (len(mesh.faces), 3, 2)).copy()
    return Mesh(vertices, mesh.normals, mesh.faces, uv, tile, mesh.owner)
