"""The inner loops of the parking lot's renderer, compiled by numba: one core, deterministic.

Arrays are those of Mesh, Atlas, Light and Camera. Nothing here is checked: shapes and types are the
business of the functions that call.
"""
# mypy: ignore-errors

from __future__ import annotations

import math
from inspect import unwrap

import numpy as np
from numba import njit

from mixer_torch.demo.textures import LEVELS, MATTE

SCENERY, FOLIAGE, GROUND = -1, -2, -3  # owners of triangles that are no car's
PANORAMA = (384, 1536)  # rows and columns of what is far away
SHADOW_CELL = 0.05  # metres a pixel of the sun's depth map
SHADOW_SLACK = 0.15  # metres by which a surface may lie behind itself in that map
GROUND_CELL = 0.04  # metres a texel of the ground
GRAIN_CELL = 0.012  # metres a cell of the asphalt's grain


def compiled(function):
    """Compile when first called. Checks of types, which tests put around it, are taken off."""
    return njit(cache=True, error_model="numpy")(unwrap(function))


@compiled
def _cross(a, b, c):
    """Twice the signed area of a triangle in the plane."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


@compiled
def _flat_weights(a, b, c, area, x, y):
    """Barycentric coordinates of a pixel in the image; negative outside of the triangle."""
    wa, wb = _cross((x, y), b, c) / area, _cross((x, y), c, a) / area
    return wa, wb, 1.0 - wa - wb


@compiled
def _weights(a, b, c, area, x, y):
    """The same on the triangle in space: inverse depth, not depth, is linear in the image."""
    wa, wb, wc = _flat_weights(a, b, c, area, x, y)
    wa, wb, wc = wa * a[2], wb * b[2], wc * c[2]
    total = wa + wb + wc
    return wa / total, wb / total, wc / total


@compiled
def _row(rows, k):
    """A row of three as a tuple, which costs less in an inner loop than a view of the array."""
    return rows[k, 0], rows[k, 1], rows[k, 2]


@compiled
def _mix(rows, a, b, c, weights):
    """The weighted mean of three rows of three."""
    wa, wb, wc = weights
    return (
        wa * rows[a, 0] + wb * rows[b, 0] + wc * rows[c, 0],
        wa * rows[a, 1] + wb * rows[b, 1] + wc * rows[c, 1],
        wa * rows[a, 2] + wb * rows[b, 2] + wc * rows[c, 2],
    )


@compiled
def _coordinate(uv, t, weights):
    """Where on its texture a point of a triangle lies."""
    wa, wb, wc = weights
    u = wa * uv[t, 0, 0] + wb * uv[t, 1, 0] + wc * uv[t, 2, 0]
    v = wa * uv[t, 0, 1] + wb * uv[t, 1, 1] + wc * uv[t, 2, 1]
    return u, v


@compiled
def _gloss(table, texels, tile, level, u, v):
    """Of the nearest texel."""
    rows, columns = table[tile, level, 1], table[tile, level, 2]
    i = min(rows - 1, max(0, int(v * rows)))
    j = min(columns - 1, max(0, int(u * columns)))
    return texels[table[tile, level, 0] + i * columns + j, 3]


@compiled
def rasterise(screen, faces, uv, tile, owner, table, texels, nearest, face):
    """The z-buffer: nearest inverse depth and its triangle, of each pixel."""
    height, width = nearest.shape
    for t in range(len(faces)):
        a, b, c = _row(screen, faces[t, 0]), _row(screen, faces[t, 1]), _row(screen, faces[t, 2])
        area = _cross(a, b, c)
        if min(a[2], b[2], c[2]) <= 0.0 or abs(area) < 1e-9:
            continue  # a corner behind the camera, or a triangle seen from its edge
        top = max(0, math.ceil(min(a[1], b[1], c[1]) - 0.5))
        bottom = min(height, math.floor(max(a[1], b[1], c[1]) - 0.5) + 1)
        left = max(0, math.ceil(min(a[0], b[0], c[0]) - 0.5))
        right = min(width, math.floor(max(a[0], b[0], c[0]) - 0.5) + 1)
        for i in range(top, bottom):
            for j in range(left, right):
                wa, wb, wc = _flat_weights(a, b, c, area, j + 0.5, i + 0.5)
                near = wa * a[2] + wb * b[2] + wc * c[2]
                if wa < 0.0 or wb < 0.0 or wc < 0.0 or near <= nearest[i, j]:
                    continue
                if owner[t] == FOLIAGE:
                    weights = _weights(a, b, c, area, j + 0.5, i + 0.5)
                    u, v = _coordinate(uv, t, weights)
                    if _gloss(table, texels, tile[t], 0, u, v) < MATTE // 2:
                        continue
                nearest[i, j], face[i, j] = near, t


@compiled
def _channel(texels, first, columns, fx, fy, k):
    upper = (1 - fx) * texels[first, k] + fx * texels[first + 1, k]
    first += columns
    lower = (1 - fx) * texels[first, k] + fx * texels[first + 1, k]
    light = ((1 - fy) * upper + fy * lower) / 255.0
    return light * light


@compiled
def _sample(texels, first, rows, columns, u, v):
    """Linear RGB by bilinear interpolation of a texture that holds 255 times its square root."""
    x = min(max(u * columns - 0.5, 0.0), columns - 1.001)
    y = min(max(v * rows - 0.5, 0.0), rows - 1.001)
    j, i = int(x), int(y)
    first += i * columns + j
    return (
        _channel(texels, first, columns, x - j, y - i, 0),
        _channel(texels, first, columns, x - j, y - i, 1),
        _channel(texels, first, columns, x - j, y - i, 2),
    )


@compiled
def _far(panorama, x, y, z):
    """What is seen far away in a direction; rows are spaced by sqrt(|z|), dense at the horizon."""
    v = 0.5 - 0.5 * math.copysign(math.sqrt(abs(z)), z)
    return _sample(panorama, 0, PANORAMA[0], PANORAMA[1], math.atan2(y, x) / math.tau + 0.5, v)


@compiled
def _sunlit(shadow, axes, corner, place):
    """Fraction of the sun that arrives at a point, by bilinear comparison with the depth map."""
    x, y, z = place
    u = (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z - corner[0]) / SHADOW_CELL - 0.5
    v = (axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z - corner[1]) / SHADOW_CELL - 0.5
    depth = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z - corner[2] + SHADOW_SLACK
    j, i = math.floor(u), math.floor(v)
    fx, fy = u - j, v - i
    top = (1 - fx) * (shadow[i, j] <= depth) + fx * (shadow[i, j + 1] <= depth)
    low = (1 - fx) * (shadow[i + 1, j] <= depth) + fx * (shadow[i + 1, j + 1] <= depth)
    return (1 - fy) * top + fy * low


@compiled
def _surface(albedo, gloss, normal, ray, height, lit, light, panorama):
    """Outgoing light of a point: diffuse, and where it is glossy a coat that mirrors sky and sun.

    Rows of light: direction of the sun, its colour, the sky's, what comes from below.
    """
    nx, ny, nz = normal
    diffuse = lit * max(nx * light[0, 0] + ny * light[0, 1] + nz * light[0, 2], 0.0)
    open_sky = 0.35 + 0.65 * min(1.0, max(0.0, height / 0.7))  # less of it beneath a car
    sky, below = open_sky * (0.5 + 0.5 * nz), open_sky * (0.5 - 0.5 * nz)
    red = albedo[0] * (diffuse * light[1, 0] + sky * light[2, 0] + below * light[3, 0])
    green = albedo[1] * (diffuse * light[1, 1] + sky * light[2, 1] + below * light[3, 1])
    blue = albedo[2] * (diffuse * light[1, 2] + sky * light[2, 2] + below * light[3, 2])
    if gloss <= MATTE:
        return red, green, blue
    base = 0.5 * ((gloss - MATTE) / (255 - MATTE)) ** 2
    cosine = -(nx * ray[0] + ny * ray[1] + nz * ray[2])
    # Schlick's approximation of Fresnel's law, and a narrow and a wide lobe of Phong's.
    mirror = base + 0.8 * (1.0 - base) * (1.0 - min(1.0, max(0.0, cosine))) ** 5
    rx, ry, rz = ray[0] + 2 * cosine * nx, ray[1] + 2 * cosine * ny, ray[2] + 2 * cosine * nz
    spark = max(0.0, rx * light[0, 0] + ry * light[0, 1] + rz * light[0, 2])
    glint = 9.0 * lit * mirror * (spark**350 + 0.02 * spark**24)
    far = _far(panorama, rx, ry, rz)
    return (
        (1.0 - mirror) * red + mirror * far[0] + glint * light[1, 0],
        (1.0 - mirror) * green + mirror * far[1] + glint * light[1, 1],
        (1.0 - mirror) * blue + mirror * far[2] + glint * light[1, 2],
    )


@compiled
def _levels(screen, faces, uv, tile, table):
    """Of each triangle: texels a pixel along a side, and the level that has about one."""
    step, level = np.empty(len(faces)), np.empty(len(faces), np.int64)
    for t in range(len(faces)):
        area = abs(_cross(screen[faces[t, 0]], screen[faces[t, 1]], screen[faces[t, 2]]))
        texels = abs(_cross(uv[t, 0], uv[t, 1], uv[t, 2])) * table[tile[t], 0, 1]
        step[t] = max(math.sqrt(texels * table[tile[t], 0, 2] / max(area, 1e-3)), 1e-3)
        level[t] = min(max(int(math.log2(step[t]) + 0.25), 0), LEVELS - 1)
    return step, level


@compiled
def shade(face, screen, camera, mesh, atlas, light, image):
    """Light of each pixel; rows of camera: its three axes, its place, its focal length."""
    vertices, normals, faces, uv, tile, owner = mesh
    table, texels, grain = atlas
    colours, panorama, shadow, axes, corner = light
    height, width = face.shape
    steps, levels = _levels(screen, faces, uv, tile, table)
    for i in range(height):
        for j in range(width):
            lx, ly = (j + 0.5 - width / 2) / camera[4, 0], (i + 0.5 - height / 2) / camera[4, 0]
            unit = 1.0 / math.sqrt(lx * lx + ly * ly + 1.0)
            ray = _mix(camera, 0, 1, 2, (lx * unit, ly * unit, unit))
            t = face[i, j]
            if t < 0:
                colour = _far(panorama, ray[0], ray[1], ray[2])
                image[i, j, 0], image[i, j, 1], image[i, j, 2] = colour
                continue
            a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
            pa, pb, pc = _row(screen, a), _row(screen, b), _row(screen, c)
            weights = _weights(pa, pb, pc, _cross(pa, pb, pc), j + 0.5, i + 0.5)
            u, v = _coordinate(uv, t, weights)
            place, (nx, ny, nz) = _mix(vertices, a, b, c, weights), _mix(normals, a, b, c, weights)
            unit = 1.0 / (math.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12)
            k, level = tile[t], levels[t]
            first, rows, columns = table[k, level, 0], table[k, level, 1], table[k, level, 2]
            albedo = _sample(texels, first, rows, columns, u, v)
            if owner[t] == GROUND:
                n, x, y = len(grain), int(place[0] / GRAIN_CELL), int(place[1] / GRAIN_CELL)
                rough = 1.0 + max(0.0, 1.0 - steps[t] * GROUND_CELL / 0.05) * grain[y % n, x % n]
                albedo = (albedo[0] * rough, albedo[1] * rough, albedo[2] * rough)
            lit = 1.0 if owner[t] == FOLIAGE else _sunlit(shadow, axes, corner, place)
            low = place[2] if owner[t] >= 0 else 1.0
            gloss = _gloss(table, texels, k, level, u, v)
            normal = (nx * unit, ny * unit, nz * unit)
            colour = _surface(albedo, gloss, normal, ray, low, lit, colours, panorama)
            image[i, j, 0], image[i, j, 1], image[i, j, 2] = colour
