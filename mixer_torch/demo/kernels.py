"""The inner loops of the parking lot's renderer, compiled by numba: one core, deterministic.

Arrays are those of Mesh, Atlas, Ground and Light; triangles are told by number. Nothing here is
checked: shapes and types are the business of the functions that call.
"""

from __future__ import annotations

import math
from typing import no_type_check

from numba import njit

from mixer_torch.demo.textures import CHROME, CUT, GLASS, MATTE

SCENERY, FOLIAGE = -1, -2  # owners that are no car; foliage takes no hard shadow
SUN_DEPTH = 1000.0  # added to depths along the sun, so that they are positive
SHADOW_CELL = 0.05  # metres
SHADOW_SLACK = 0.15  # metres by which a surface may lie behind itself in the depth map
GRAIN_CELL = 0.012  # metres
HORIZON = 90.0  # metres to which the ground is drawn


@njit(cache=True, error_model="numpy")
@no_type_check
def _bounds(screen, a, b, c, height, width):
    """Rows and columns whose pixel centres a triangle may cover: first and one past the last."""
    ax, ay, bx, by = screen[a, 0], screen[a, 1], screen[b, 0], screen[b, 1]
    cx, cy = screen[c, 0], screen[c, 1]
    top = max(0, math.ceil(min(ay, by, cy) - 0.5))
    bottom = min(height, math.floor(max(ay, by, cy) - 0.5) + 1)
    left = max(0, math.ceil(min(ax, bx, cx) - 0.5))
    right = min(width, math.floor(max(ax, bx, cx) - 0.5) + 1)
    return top, bottom, left, right


@njit(cache=True, error_model="numpy")
@no_type_check
def _twice_area(screen, a, b, c):
    """Signed; 0 for what is not to be drawn: a corner behind the camera, or no area."""
    if screen[a, 2] <= 0.0 or screen[b, 2] <= 0.0 or screen[c, 2] <= 0.0:
        return 0.0
    ab = (screen[b, 0] - screen[a, 0], screen[b, 1] - screen[a, 1])
    ac = (screen[c, 0] - screen[a, 0], screen[c, 1] - screen[a, 1])
    area = ab[0] * ac[1] - ab[1] * ac[0]
    return area if abs(area) > 1e-9 else 0.0


@njit(cache=True, error_model="numpy")
@no_type_check
def _flat_weights(screen, a, b, c, area, x, y):
    """Barycentric coordinates of a pixel in the plane of the image; negative outside."""
    ax, ay, bx, by = screen[a, 0], screen[a, 1], screen[b, 0], screen[b, 1]
    cx, cy = screen[c, 0], screen[c, 1]
    wa = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
    wb = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
    return wa, wb, 1.0 - wa - wb


@njit(cache=True, error_model="numpy")
@no_type_check
def _is_hole(texels, table, tile, uv, t, screen, a, b, c, x, y):
    """Whether a triangle's texture is cut out at a pixel."""
    wa, wb, wc = _weights(screen, a, b, c, x, y)
    u = wa * uv[t, 0, 0] + wb * uv[t, 1, 0] + wc * uv[t, 2, 0]
    v = wa * uv[t, 0, 1] + wb * uv[t, 1, 1] + wc * uv[t, 2, 1]
    rows, columns = table[tile, 0, 1], table[tile, 0, 2]
    i = min(rows - 1, max(0, int(v * rows)))
    j = min(columns - 1, max(0, int(u * columns)))
    return texels[table[tile, 0, 0] + i * columns + j, 3] == CUT


@njit(cache=True, error_model="numpy")
@no_type_check
def rasterise(screen, faces, uv, tile, cut, table, texels, nearest, face):
    """The z-buffer: nearest inverse depth and its triangle, of each pixel."""
    height, width = nearest.shape
    for t in range(len(faces)):
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        area = _twice_area(screen, a, b, c)
        if area == 0.0:
            continue
        top, bottom, left, right = _bounds(screen, a, b, c, height, width)
        for i in range(top, bottom):
            for j in range(left, right):
                wa, wb, wc = _flat_weights(screen, a, b, c, area, j + 0.5, i + 0.5)
                if wa < 0.0 or wb < 0.0 or wc < 0.0:
                    continue
                z = wa * screen[a, 2] + wb * screen[b, 2] + wc * screen[c, 2]
                if z <= nearest[i, j]:
                    continue
                k = tile[t]
                if cut[k] and _is_hole(texels, table, k, uv, t, screen, a, b, c, j + 0.5, i + 0.5):
                    continue
                nearest[i, j] = z
                face[i, j] = t


@njit(cache=True, error_model="numpy")
@no_type_check
def coverage(screen, faces, owner, stamp, covered):
    """Counts a pixel once for a car: its triangles follow one another, and leave their stamp."""
    height, width = stamp.shape
    for t in range(len(faces)):
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        area = _twice_area(screen, a, b, c)
        if area == 0.0 or owner[t] < 0:
            continue
        top, bottom, left, right = _bounds(screen, a, b, c, height, width)
        for i in range(top, bottom):
            for j in range(left, right):
                wa, wb, wc = _flat_weights(screen, a, b, c, area, j + 0.5, i + 0.5)
                if wa >= 0.0 and wb >= 0.0 and wc >= 0.0 and stamp[i, j] != owner[t]:
                    stamp[i, j] = owner[t]
                    covered[owner[t]] += 1


@njit(cache=True, error_model="numpy")
@no_type_check
def _sample(table, texels, tile, level, u, v):
    """Bilinear linear-light RGB (gamma 2) and the nearest material."""
    offset, h, w = table[tile, level, 0], table[tile, level, 1], table[tile, level, 2]
    x = min(max(u * w - 0.5, 0.0), w - 1.001)
    y = min(max(v * h - 0.5, 0.0), h - 1.001)
    j, i = int(x), int(y)
    fx, fy = x - j, y - i
    j1, i1 = min(j + 1, w - 1), min(i + 1, h - 1)
    a, b = offset + i * w + j, offset + i * w + j1
    c, d = offset + i1 * w + j, offset + i1 * w + j1
    wa, wb = (1 - fx) * (1 - fy) / 255.0, fx * (1 - fy) / 255.0
    wc, wd = (1 - fx) * fy / 255.0, fx * fy / 255.0
    red = wa * texels[a, 0] + wb * texels[b, 0] + wc * texels[c, 0] + wd * texels[d, 0]
    green = wa * texels[a, 1] + wb * texels[b, 1] + wc * texels[c, 1] + wd * texels[d, 1]
    blue = wa * texels[a, 2] + wb * texels[b, 2] + wc * texels[c, 2] + wd * texels[d, 2]
    row, column = (i if fy < 0.5 else i1), (j if fx < 0.5 else j1)
    material = texels[offset + row * w + column, 3]
    return red * red, green * green, blue * blue, material


@njit(cache=True, error_model="numpy")
@no_type_check
def _far(panorama, dx, dy, dz):
    """What is seen far away in a direction; rows are spaced by sqrt(|z|), dense at the horizon."""
    rows, columns, _ = panorama.shape
    lift = math.copysign(math.sqrt(abs(dz)), dz)
    y = min(max((0.5 - 0.5 * lift) * rows - 0.5, 0.0), rows - 1.001)
    x = (math.atan2(dy, dx) / (2.0 * math.pi) + 0.5) * columns - 0.5
    i, j = int(y), math.floor(x)
    fy, fx = y - i, x - j
    j0, j1 = j % columns, (j + 1) % columns
    wa, wb, wc, wd = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
    return (
        wa * panorama[i, j0, 0] + wb * panorama[i, j1, 0]
        + wc * panorama[i + 1, j0, 0] + wd * panorama[i + 1, j1, 0],
        wa * panorama[i, j0, 1] + wb * panorama[i, j1, 1]
        + wc * panorama[i + 1, j0, 1] + wd * panorama[i + 1, j1, 1],
        wa * panorama[i, j0, 2] + wb * panorama[i, j1, 2]
        + wc * panorama[i + 1, j0, 2] + wd * panorama[i + 1, j1, 2],
    )  # fmt: skip


@njit(cache=True, error_model="numpy")
@no_type_check
def _sunlit(shadow, axes, corner, x, y, z):
    """Fraction of the sun that arrives at a point, by bilinear comparison with the depth map."""
    rows, columns = shadow.shape
    u = (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z - corner[0]) / SHADOW_CELL - 0.5
    v = (axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z - corner[1]) / SHADOW_CELL - 0.5
    depth = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2] * z + SUN_DEPTH + SHADOW_SLACK
    j, i = math.floor(u), math.floor(v)
    if i < 0 or j < 0 or i >= rows - 1 or j >= columns - 1:
        return 1.0
    fx, fy = u - j, v - i
    top = (1 - fx) * (shadow[i, j] <= depth) + fx * (shadow[i, j + 1] <= depth)
    low = (1 - fx) * (shadow[i + 1, j] <= depth) + fx * (shadow[i + 1, j + 1] <= depth)
    return (1 - fy) * top + fy * low


@njit(cache=True, error_model="numpy")
@no_type_check
def _surface(albedo, material, normal, ray, height, lit, light, panorama):
    """Outgoing light of a point: diffuse, and by material a coat that mirrors sky and sun.

    Rows of light: direction of the sun, its colour, the sky's, what comes from below.
    """
    nx, ny, nz = normal
    facing = nx * light[0, 0] + ny * light[0, 1] + nz * light[0, 2]
    diffuse = max(facing, 0.0) * lit
    up = 0.5 + 0.5 * nz
    open_sky = 0.35 + 0.65 * min(1.0, max(0.0, height / 0.7))
    sky, below = open_sky * up, open_sky * (1.0 - up)
    red = albedo[0] * (diffuse * light[1, 0] + sky * light[2, 0] + below * light[3, 0])
    green = albedo[1] * (diffuse * light[1, 1] + sky * light[2, 1] + below * light[3, 1])
    blue = albedo[2] * (diffuse * light[1, 2] + sky * light[2, 2] + below * light[3, 2])
    if material == MATTE:
        return red, green, blue
    base, shine = 0.045, 6.0
    if material == GLASS:
        base, shine = 0.09, 14.0
    if material == CHROME:
        base, shine = 0.45, 10.0
    cosine = -(nx * ray[0] + ny * ray[1] + nz * ray[2])
    grazing = 1.0 - min(1.0, max(0.0, cosine))
    mirror = base + 0.8 * (1.0 - base) * grazing**5
    rx, ry, rz = ray[0] + 2 * cosine * nx, ray[1] + 2 * cosine * ny, ray[2] + 2 * cosine * nz
    far = _far(panorama, rx, ry, rz)
    spark = max(0.0, rx * light[0, 0] + ry * light[0, 1] + rz * light[0, 2])
    glint = lit * shine * mirror * (spark**350 + 0.02 * spark**24)
    return (
        red * (1.0 - mirror) + mirror * far[0] + glint * light[1, 0],
        green * (1.0 - mirror) + mirror * far[1] + glint * light[1, 1],
        blue * (1.0 - mirror) + mirror * far[2] + glint * light[1, 2],
    )


@njit(cache=True, error_model="numpy")
@no_type_check
def _ground(table, texels, origin, cell, grain, x, y, footprint):
    """Albedo of the ground: the painted lot, coarser with distance, and the grain of asphalt."""
    level = min(max(int(math.log2(max(footprint / cell, 1e-6)) + 0.5), 0), table.shape[1] - 1)
    h, w = table[0, 0, 1], table[0, 0, 2]
    u, v = (x - origin[0]) / (cell * w), (origin[1] - y) / (cell * h)
    red, green, blue, _ = _sample(table, texels, 0, level, u, v)
    n = grain.shape[0]
    fade = max(0.0, 1.0 - footprint / 0.05)
    rough = 1.0 + fade * grain[math.floor(y / GRAIN_CELL) % n, math.floor(x / GRAIN_CELL) % n]
    return red * rough, green * rough, blue * rough


@njit(cache=True, error_model="numpy")
@no_type_check
def _mix(rows, a, b, c, weights):
    """The weighted mean of three rows of three."""
    wa, wb, wc = weights
    return (
        wa * rows[a, 0] + wb * rows[b, 0] + wc * rows[c, 0],
        wa * rows[a, 1] + wb * rows[b, 1] + wc * rows[c, 1],
        wa * rows[a, 2] + wb * rows[b, 2] + wc * rows[c, 2],
    )


@njit(cache=True, error_model="numpy")
@no_type_check
def _weights(screen, a, b, c, x, y):
    """Perspective-correct barycentric coordinates of a pixel in a triangle."""
    ax, ay, bx, by = screen[a, 0], screen[a, 1], screen[b, 0], screen[b, 1]
    cx, cy = screen[c, 0], screen[c, 1]
    wa = ((bx - x) * (cy - y) - (by - y) * (cx - x)) * screen[a, 2]
    wb = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) * screen[b, 2]
    wc = ((ax - x) * (by - y) - (ay - y) * (bx - x)) * screen[c, 2]
    total = wa + wb + wc
    return wa / total, wb / total, wc / total


@njit(cache=True, error_model="numpy")
@no_type_check
def _ray(camera, height, width, i, j):
    """Unit vector through a pixel; camera: the rows of its axes, its place, its focal length."""
    lx, ly = (j + 0.5 - width / 2) / camera[4, 0], (i + 0.5 - height / 2) / camera[4, 0]
    scale = 1.0 / math.sqrt(lx * lx + ly * ly + 1.0)
    return _mix(camera, 0, 1, 2, (lx * scale, ly * scale, scale))


@njit(cache=True, error_model="numpy")
@no_type_check
def shade_faces(face, screen, camera, mesh, atlas, shadow, light, panorama, image):
    """Light of the pixels that show a triangle."""
    vertices, normals, faces, uv, tile, owner = mesh
    table, texels, level = atlas
    depths, axes, corner = shadow
    height, width = face.shape
    for i in range(height):
        for j in range(width):
            t = face[i, j]
            if t < 0:
                continue
            a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
            weights = _weights(screen, a, b, c, j + 0.5, i + 0.5)
            wa, wb, wc = weights
            u = wa * uv[t, 0, 0] + wb * uv[t, 1, 0] + wc * uv[t, 2, 0]
            v = wa * uv[t, 0, 1] + wb * uv[t, 1, 1] + wc * uv[t, 2, 1]
            x, y, z = _mix(vertices, a, b, c, weights)
            nx, ny, nz = _mix(normals, a, b, c, weights)
            norm = math.sqrt(nx * nx + ny * ny + nz * nz) + 1e-12
            normal = (nx / norm, ny / norm, nz / norm)
            red, green, blue, material = _sample(table, texels, tile[t], level[t], u, v)
            lit = _sunlit(depths, axes, corner, x, y, z) if owner[t] > FOLIAGE else 1.0
            ray = _ray(camera, height, width, i, j)
            low = z if owner[t] >= 0 else 1.0
            colour = _surface((red, green, blue), material, normal, ray, low, lit, light, panorama)
            image[i, j, 0], image[i, j, 1], image[i, j, 2] = colour


@njit(cache=True, error_model="numpy")
@no_type_check
def shade_rest(face, camera, ground, shadow, light, panorama, image):
    """Light of the pixels that show no triangle: the ground or what is far away."""
    table, texels, origin, cell, grain = ground
    depths, axes, corner = shadow
    height, width = face.shape
    up = (0.0, 0.0, 1.0)
    for i in range(height):
        for j in range(width):
            if face[i, j] >= 0:
                continue
            ray = _ray(camera, height, width, i, j)
            if ray[2] < -1e-4 and -camera[3, 2] / ray[2] < HORIZON:
                reach = -camera[3, 2] / ray[2]
                x, y = camera[3, 0] + reach * ray[0], camera[3, 1] + reach * ray[1]
                footprint = reach / camera[4, 0] * math.sqrt(reach / camera[3, 2])
                albedo = _ground(table, texels, origin, cell, grain, x, y, footprint)
                lit = _sunlit(depths, axes, corner, x, y, 0.0)
                colour = _surface(albedo, MATTE, up, ray, 1.0, lit, light, panorama)
            else:
                colour = _far(panorama, ray[0], ray[1], ray[2])
            image[i, j, 0], image[i, j, 1], image[i, j, 2] = colour
