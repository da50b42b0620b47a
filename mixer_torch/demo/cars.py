"""Cars of the parking lot: body styles, and their surfaces as lofts of cross-sections."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.interpolate import PchipInterpolator

from mixer_torch.demo.rendering import Mesh

TEXTURES = RIGHT, LEFT, FRONT, BACK, TOP, RIM = range(6)
DRAWN_HEIGHT = 2.1  # metres that the textures of the sides, the front and the back cover
SPARE = 0.4  # metres by which a texture is longer or wider than the car, half on each side


@dataclass(frozen=True)
class Body:
    """A car model. Metres; stations are fractions of the length, from the front bumper.

    Args:
        name: Body style.
        share: Of the cars that have it.
        length: From bumper to bumper.
        width: Without mirrors.
        profile: Rows of station and height along the roof line, from 0 to 1.
        cabin: Stations of the windscreen's foot, the roof's front and rear, the rear window's foot.
        belt: Heights of the windows' lower edge at the windscreen and at the rear.
        axles: Stations of the wheels.
        wheel: Radius of a wheel.
        clearance: Height of the sill.
        spokes: Of a rim.
    """

    name: str
    share: float
    length: float
    width: float
    profile: tuple[tuple[float, float], ...]
    cabin: tuple[float, float, float, float]
    belt: tuple[float, float]
    axles: tuple[float, float]
    wheel: float
    clearance: float
    spokes: int

    def top(self, station: Any) -> Any:
        """Height of the roof line at stations."""
        return PchipInterpolator(*zip(*self.profile, strict=True))(np.clip(station, 0, 1))

    def shoulder(self, station: Any) -> Any:
        """Height at which the side ends and glass, bonnet or boot begin."""
        belt = np.interp(station, self.cabin[::3], self.belt)
        return np.minimum(self.top(station) - 0.03, belt)

    def along(self, station: Any) -> Any:
        """Coordinate, positive to the front, of stations."""
        return self.length * (0.5 - np.asarray(station))


BODIES = (
    Body("sedan", 0.2, 4.62, 1.82, ((0.0, 0.58), (0.02, 0.68), (0.1, 0.80), (0.28, 0.97),
         (0.46, 1.38), (0.57, 1.45), (0.70, 1.40), (0.86, 1.08), (0.97, 1.03), (1.0, 0.88)),
         (0.28, 0.455, 0.70, 0.865), (0.93, 0.99), (0.19, 0.80), 0.325, 0.20, 5),
    Body("saloon", 0.14, 4.90, 1.86, ((0.0, 0.60), (0.02, 0.72), (0.1, 0.84), (0.31, 0.99),
         (0.47, 1.40), (0.56, 1.47), (0.67, 1.43), (0.82, 1.13), (0.97, 1.08), (1.0, 0.90)),
         (0.31, 0.47, 0.675, 0.825), (0.95, 1.03), (0.18, 0.79), 0.345, 0.19, 10),
    Body("hatchback", 0.2, 4.05, 1.75, ((0.0, 0.56), (0.02, 0.70), (0.1, 0.84), (0.25, 0.99),
         (0.44, 1.43), (0.58, 1.49), (0.84, 1.43), (0.955, 1.02), (1.0, 0.72)),
         (0.25, 0.44, 0.85, 0.955), (0.94, 1.02), (0.19, 0.82), 0.31, 0.20, 7),
    Body("compact", 0.12, 3.62, 1.64, ((0.0, 0.60), (0.03, 0.76), (0.12, 0.90), (0.22, 1.00),
         (0.42, 1.47), (0.58, 1.53), (0.87, 1.46), (0.965, 1.02), (1.0, 0.74)),
         (0.22, 0.42, 0.88, 0.965), (0.93, 1.00), (0.17, 0.83), 0.29, 0.19, 4),
    Body("SUV", 0.16, 4.52, 1.86, ((0.0, 0.66), (0.02, 0.88), (0.1, 1.00), (0.25, 1.10),
         (0.40, 1.57), (0.55, 1.67), (0.85, 1.61), (0.965, 1.16), (1.0, 0.82)),
         (0.25, 0.405, 0.86, 0.965), (1.05, 1.13), (0.19, 0.81), 0.365, 0.27, 6),
    Body("wagon", 0.12, 4.70, 1.82, ((0.0, 0.57), (0.02, 0.68), (0.1, 0.80), (0.27, 0.97),
         (0.44, 1.40), (0.55, 1.47), (0.87, 1.41), (0.965, 1.04), (1.0, 0.74)),
         (0.27, 0.44, 0.88, 0.965), (0.93, 1.01), (0.19, 0.79), 0.325, 0.20, 8),
    Body("van", 0.06, 4.85, 1.92, ((0.0, 0.66), (0.02, 0.86), (0.1, 1.03), (0.17, 1.13),
         (0.33, 1.80), (0.45, 1.92), (0.93, 1.90), (0.985, 1.15), (1.0, 0.80)),
         (0.17, 0.325, 0.95, 0.985), (1.06, 1.10), (0.18, 0.80), 0.335, 0.22, 9),
)  # fmt: skip


def car_mesh(body: Body, number: int, first_tile: int) -> Mesh:
    """A car at the origin, its front towards +x.

    Args:
        body: Model.
        number: Owner of the triangles.
        first_tile: Tile of its RIGHT; the others follow in the order of TEXTURES.
    """
    rings = _rings(body)
    parts = [_panels(rings, body, (0.75, 1.0, 0.9))]
    parts += [_panels(_cap(rings[end], end == 0), body, (1.0, 0.5, 0.6)) for end in (0, -1)]
    for side in (1.0, -1.0):
        parts += [part for station in body.axles for part in _wheel(body, station, side)]
        parts.append(_mirror(body, side))
    mesh = Mesh.join(parts)
    return replace(mesh, tile=mesh.tile + first_tile, owner=mesh.owner + number)


def _rings(body: Body) -> np.ndarray:
    """(stations, points, 3) cross-sections, front to rear, from the left sill over the roof."""
    knots = [0, 0.008, 0.02, 0.045, 0.08, 0.92, 0.955, 0.98, 0.992, 1, *body.cabin, *body.axles]
    stations = np.unique(np.round([*knots, *np.linspace(0.12, 0.88, 15)], 4))
    top, shoulder = body.top(stations), body.shoulder(stations)
    end = np.abs(2 * stations - 1)  # 0 in the middle of the car, 1 at both ends
    half = body.width / 2 * (1 - 0.05 * end**4 - 0.10 * end**16)
    sill = body.clearance + 0.10 * end**24
    rise = top - shoulder
    cabin = np.clip(rise / max(body.top(0.5) - body.belt[0], 0.1), 0, 1)
    roof = half * (0.93 - 0.19 * cabin)
    outline = (  # half width and height, from the sill to the middle of the roof
        (0.90 * half, sill), (0.985 * half, sill + 0.07), (half, 0.55 * shoulder + 0.45 * sill),
        (0.975 * half, shoulder - 0.05), (0.93 * half, shoulder), (roof, shoulder + 0.86 * rise),
        (0.80 * roof, shoulder + 0.97 * rise), (0 * half, top),
    )  # fmt: skip
    left = np.moveaxis(np.array(outline), 2, 0)
    section = np.concatenate([left, left[:, -2::-1] * [-1, 1]], axis=1)
    along = np.repeat(body.along(stations)[:, None], section.shape[1], axis=1)
    bend = np.sign(along) * 0.16 * (section[..., 0] / (body.width / 2)) ** 2 * end[:, None] ** 8
    return np.concatenate([(along - bend)[..., None], section], axis=2)


def _cap(ring: np.ndarray, is_front: bool) -> np.ndarray:
    """A bumper: the end ring's left and right halves joined by rows, bulging outwards."""
    count = len(ring) // 2
    left, right = ring[:count], ring[: -count - 1 : -1]
    across = np.linspace(0, 1, 7)[:, None, None]
    cap = left * (1 - across) + right * across
    cap[..., 0] += (1 if is_front else -1) * 0.14 * (1 - (2 * across[..., 0] - 1) ** 2)
    return cap[::-1] if is_front else cap


def _panels(points: np.ndarray, body: Body, weights: tuple[float, float, float]) -> Mesh:
    """A grid with the texture of the side that each quad faces most, projected onto it.

    The weights favour some of the three axes over others where a quad faces between them.
    """
    facing = np.cross(points[1:, 1:] - points[:-1, :-1], points[:-1, 1:] - points[1:, :-1])
    facing = facing.reshape(-1, 3) * weights
    sides = np.array([(FRONT, BACK), (LEFT, RIGHT), (TOP, TOP)])
    axis = np.abs(facing).argmax(1)
    tile = np.tile(sides[axis, (facing[np.arange(len(axis)), axis] < 0).astype(int)], 2)
    mesh = Mesh.grid(points, points[..., :2], 0, 0)
    x, y, z = np.moveaxis(mesh.vertices[mesh.faces], -1, 0)
    along, across = x / (body.length + SPARE), y / (body.width + SPARE)
    u = 0.5 + np.choose(tile[:, None], [along, -along, across, -across, along])
    v = np.where(tile[:, None] == TOP, 0.5 - across, 1 - z / DRAWN_HEIGHT)
    return replace(mesh, tile=tile, uv=np.stack([u, v], axis=-1))


def _wheel(body: Body, station: float, side: float) -> tuple[Mesh, Mesh]:
    """A disc with the rim, and the tread behind it."""
    turn = np.linspace(0, 2 * np.pi, 17)
    circle = np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=1)
    centre = np.array([body.along(station), side * (body.width / 2 + 0.004), body.wheel])
    outer = centre + body.wheel * circle
    inner = outer - [0, side * 0.22, 0]
    uv = 0.5 + 0.5 * np.stack([0 * circle, circle])[..., ::2]
    order = int(side)  # so that both face outwards
    disc = np.stack([np.broadcast_to(centre, outer.shape), outer])
    tread = np.stack([outer, inner])
    black = np.zeros((2, 17, 2))  # a corner of the rim's texture
    return (
        Mesh.grid(disc[:, ::-order], uv[:, ::-order], RIM, 0),
        Mesh.grid(tread[:, ::-order], black, RIM, 0),
    )


def _mirror(body: Body, side: float) -> Mesh:
    """A door mirror: a small ellipsoid beside the windscreen's foot, in the bonnet's colour."""
    lift, turn = np.meshgrid(np.linspace(-1.5, 1.5, 5), np.linspace(0, 2 * np.pi, 9), indexing="ij")
    ball = np.stack([np.cos(lift) * np.cos(turn), np.cos(lift) * np.sin(turn), np.sin(lift)], 2)
    at = [body.along(body.cabin[0] + 0.07), side * (body.width / 2 + 0.05), body.belt[0] + 0.08]
    uv = np.full((*ball.shape[:2], 2), [0.9, 0.5])
    return Mesh.grid((ball * [0.07, 0.12, 0.085] + at)[:, ::-1], uv, TOP, 0)
