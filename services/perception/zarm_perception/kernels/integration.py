"""A depth image in a voxel map: what of it is the robot, which voxels it marks, and which it sees through.

Camera frames are optical: z forward, x right, y down. A depth is the z of a point (m), 0 where it is unknown; of a spherical
view it is the range of the point.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zarm_geometry.kernels.compiled import kernel
from zarm_geometry.kernels.convex import core_distance
from zarm_trajectory.arrays import Array

Depth = NDArray[np.float32]
Mask = NDArray[np.uint8]

UNSEEN, FREE, OCCUPIED = 0, 1, 2
"""States of a voxel."""
PASSES = 3
"""So many images must see through an occupied voxel since one has marked it: at a surface, noise marks it in one image and not in the next."""
BLOCK = 16
"""Voxels along each edge of a block."""


class View(NamedTuple):
    """A camera at the moment of an image: focal lengths and principal point (px), its pose `turn` (3, 3) and `place` (3,) in the
    base frame, and the least and the greatest depth (m) that count. Of a `spherical` view columns are azimuths and rows elevations, focal
    lengths are in pixels a radian, and if it sees all around, the first and the last `seam` columns show again what is on the other side.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    turn: Array
    place: Array
    near: float
    far: float
    spherical: bool = False
    seam: int = 0


class Grid(NamedTuple):
    """A voxel map: `state` (nx, ny, nz) of each voxel, the number of the last image that `marked` it and of the last one that `touched` it with a
    pixel, and how many have `passed` through it since it was marked. Voxel (0, 0, 0) is centred at `origin` (3,), and each is `resolution` (m) wide. `changed` are the blocks in which a state has changed.
    """

    state: Mask
    marked: NDArray[np.int32]
    touched: NDArray[np.int32]
    passed: Mask
    changed: Mask
    origin: Array
    resolution: float


_STEP = 0.03
"""The largest step between neighbouring pixels of one surface, as a share of its depth."""
_MIN_SQUARES_PER_VOXEL = 8
"""At least so many squares of the least depths lie along a voxel in the image: what is beside it counts less."""
_COVERED = 8.0
"""On how many pixels a voxel must appear for two of them to be asked for."""
_KNOWN = 5
"""So many neighbours with a depth close a hole."""
_NEIGHBOURS = 3
"""Least number of the eight neighbours on the same surface: a line of pixels that a camera smears over an edge has two."""


@kernel
def cleaned(depth: Depth, view: View, out: Depth) -> None:
    """Write to `out` the depths (h, w) that count: 0 where a depth is unknown or too near, where too few
    neighbours are on the same surface, as where a camera smears an edge (a LiDAR does not); and the greatest for what is beyond.
    """
    height, width = depth.shape
    near, far, step = np.float32(view.near), np.float32(view.far), np.float32(_STEP)
    least = 0 if view.spherical else _NEIGHBOURS
    framed = np.full((height + 2, width + 2), np.float32(np.nan), np.float32)  # so that the loop has no branches
    framed[1:-1, 1:-1] = depth
    for v in range(height):
        for u in range(width):
            d = framed[v + 1, u + 1]
            most = step * d
            same = (
                (abs(framed[v, u] - d) <= most)
                + (abs(framed[v, u + 1] - d) <= most)
                + (abs(framed[v, u + 2] - d) <= most)
                + (abs(framed[v + 1, u] - d) <= most)
                + (abs(framed[v + 1, u + 2] - d) <= most)
                + (abs(framed[v + 2, u] - d) <= most)
                + (abs(framed[v + 2, u + 1] - d) <= most)
                + (abs(framed[v + 2, u + 2] - d) <= most)
            )
            counts = (d >= near) & ((same >= least) | (d >= far))  # not NaN
            out[v, u] = min(d, far) if counts else np.float32(0.0)


@kernel
def directions(view: View, height: int, width: int) -> tuple[Array, Array]:
    """Where the pixels look in the frame of the camera, by `rows` (h, 2) and `columns` (w, 2): a point on the pixel (v, u) is at
    `(rows[v, 0] * columns[u, 0], rows[v, 1], rows[v, 0] * columns[u, 1])`, times its depth.
    """
    rows, columns = np.ones((height, 2)), np.ones((width, 2))
    for v in range(height):
        b = (v - view.cy) / view.fy
        rows[v, 1] = b
        if view.spherical:
            rows[v, 0], rows[v, 1] = math.cos(b), math.sin(b)
    for u in range(width):
        a = (u - view.cx) / view.fx
        columns[u, 0] = a
        if view.spherical:
            columns[u, 0], columns[u, 1] = math.sin(a), math.cos(a)
    return rows, columns


@kernel
def project(points: Depth, view: View, out: Depth) -> None:
    """Write to `out` (h, w) the least depth of the `points` (n, 3), in the frame of the camera, on each pixel, 0 where there are none."""
    height, width = out.shape
    out[:] = 0.0
    for n in range(points.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        depth = np.float32(z)
        if view.spherical:
            depth = np.float32(math.sqrt(x * x + y * y + z * z))
        if not 0.0 < depth < np.inf:  # also NaN
            continue
        if view.spherical:
            u, v = view.cx + view.fx * math.atan2(x, z), view.cy + view.fy * math.asin(y / depth)
        else:
            u, v = view.cx + view.fx * x / z, view.cy + view.fy * y / z
        if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
            continue
        row, column = math.floor(v + 0.5), math.floor(u + 0.5)
        if out[row, column] == 0.0 or depth < out[row, column]:
            out[row, column] = depth


@kernel
def mask_robot(depth: Depth, view: View, parts: Array, balls: Array, padding: float, mask: Mask) -> None:
    """Set `mask` (h, w) where the point of a pixel is within `padding` (m) of one of the convex `parts` (m, 17), see
    `zarm_geometry.packed_shapes`, each inside one of `balls` (m, 4), all in the base frame.
    """
    height, width = depth.shape
    turn, place = view.turn, view.place
    rows, columns = directions(view, height, width)
    for m in range(parts.shape[0]):
        x, y, z = balls[m, 0] - place[0], balls[m, 1] - place[1], balls[m, 2] - place[2]
        a = turn[0, 0] * x + turn[1, 0] * y + turn[2, 0] * z
        b = turn[0, 1] * x + turn[1, 1] * y + turn[2, 1] * z
        c = turn[0, 2] * x + turn[1, 2] * y + turn[2, 2] * z
        r = balls[m, 3] + padding
        left, right, top, bottom = view.seam, width - view.seam, 0, height
        if view.spherical:
            away, level = math.sqrt(a * a + b * b + c * c), math.hypot(a, c)
            nearest, farthest = away - r, away + r
            if nearest > 0.01:
                high, middle = view.fy * math.asin(r / away), view.cy + view.fy * math.asin(b / away)
                top, bottom = max(0, math.floor(middle - high)), min(height, math.ceil(middle + high) + 1)
            if level > r:
                turned, wide = math.atan2(a, c), math.asin(r / level)
                if abs(turned) + wide < math.pi:
                    left = max(left, math.floor(view.cx + view.fx * (turned - wide)))
                    right = min(right, math.ceil(view.cx + view.fx * (turned + wide)) + 1)
        else:
            if c + r <= 0.0:
                continue
            nearest, farthest = c - r, c + r
            if nearest > 0.01:
                across, down = view.fx * r / nearest, view.fy * r / nearest
                u, v = view.cx + view.fx * a / c, view.cy + view.fy * b / c
                # |X / Z - a / c| <= (1 + |a / c|) r / (c - r) for every point (X, Y, Z) of the ball.
                wide, high = across + abs(u - view.cx) * r / nearest, down + abs(v - view.cy) * r / nearest
                left, right = max(0, math.floor(u - wide)), min(width, math.ceil(u + wide) + 1)
                top, bottom = max(0, math.floor(v - high)), min(height, math.ceil(v + high) + 1)
        p = parts[m]
        core = (p[12], p[13], p[14], p[15])
        most = padding + p[16]
        for v in range(top, bottom):
            level_of, down_of = rows[v, 0], rows[v, 1]
            for u in range(left, right):
                d = depth[v, u]
                if d < nearest or d > farthest or d == 0.0 or mask[v, u] != 0:
                    continue
                px, py, pz = level_of * columns[u, 0] * d, down_of * d, level_of * columns[u, 1] * d
                if (px - a) ** 2 + (py - b) ** 2 + (pz - c) ** 2 > r * r:
                    continue
                wx = turn[0, 0] * px + turn[0, 1] * py + turn[0, 2] * pz + place[0]
                wy = turn[1, 0] * px + turn[1, 1] * py + turn[1, 2] * pz + place[1]
                wz = turn[2, 0] * px + turn[2, 1] * py + turn[2, 2] * pz + place[2]
                local = (
                    p[0] * wx + p[1] * wy + p[2] * wz + p[3],
                    p[4] * wx + p[5] * wy + p[6] * wz + p[7],
                    p[8] * wx + p[9] * wy + p[10] * wz + p[11],
                )
                if core_distance(local, core) <= most:
                    mask[v, u] = 1


@kernel
def take_out(grid: Grid, parts: Array, balls: Array, padding: float, state: int) -> None:
    """Free the voxels in this `state` whose centre is within `padding` (m) of one of the convex `parts` (m, 17), each inside one of
    `balls` (m, 4).
    """
    nx, ny, nz = grid.state.shape
    origin, per = grid.origin, 1.0 / grid.resolution
    for m in range(parts.shape[0]):
        p = parts[m]
        core = (p[12], p[13], p[14], p[15])
        reach, most = balls[m, 3] + padding, padding + p[16]
        first_i = max(0, math.ceil((balls[m, 0] - reach - origin[0]) * per))
        first_j = max(0, math.ceil((balls[m, 1] - reach - origin[1]) * per))
        first_k = max(0, math.ceil((balls[m, 2] - reach - origin[2]) * per))
        last_i = min(nx - 1, math.floor((balls[m, 0] + reach - origin[0]) * per))
        last_j = min(ny - 1, math.floor((balls[m, 1] + reach - origin[1]) * per))
        last_k = min(nz - 1, math.floor((balls[m, 2] + reach - origin[2]) * per))
        for i in range(first_i, last_i + 1):
            x = origin[0] + i * grid.resolution
            for j in range(first_j, last_j + 1):
                y = origin[1] + j * grid.resolution
                for k in range(first_k, last_k + 1):
                    if grid.state[i, j, k] != state:
                        continue
                    z = origin[2] + k * grid.resolution
                    local = (
                        p[0] * x + p[1] * y + p[2] * z + p[3],
                        p[4] * x + p[5] * y + p[6] * z + p[7],
                        p[8] * x + p[9] * y + p[10] * z + p[11],
                    )
                    if core_distance(local, core) <= most:
                        grid.state[i, j, k] = FREE
                        grid.changed[i // BLOCK, j // BLOCK, k // BLOCK] = 1


@kernel
def mark(grid: Grid, depth: Depth, view: View, mask: Mask, number: int) -> int:
    """Mark as occupied the voxels in which two pixels end, or one if the voxel appears on few. Pixels of the `mask` (h, w), and those without a
    depth, do not count. Returns how many ended in the map.
    """
    height, width = depth.shape
    turn, place, origin, size = view.turn, view.place, grid.origin, grid.resolution
    nx, ny, nz = grid.state.shape
    rows, columns = directions(view, height, width)
    scaled, first = turn / size, (place - origin) / size + 0.5
    two = view.fx * view.fy * size * size / _COVERED
    count = 0
    for v in range(height):
        level, down = rows[v, 0], rows[v, 1]
        for u in range(view.seam, width - view.seam):
            d = depth[v, u]
            if d == 0.0 or d >= view.far or mask[v, u] != 0:
                continue
            x, y, z = level * columns[u, 0] * d, down * d, level * columns[u, 1] * d
            i = math.floor(scaled[0, 0] * x + scaled[0, 1] * y + scaled[0, 2] * z + first[0])
            j = math.floor(scaled[1, 0] * x + scaled[1, 1] * y + scaled[1, 2] * z + first[1])
            k = math.floor(scaled[2, 0] * x + scaled[2, 1] * y + scaled[2, 2] * z + first[2])
            if i < 0 or j < 0 or k < 0 or i >= nx or j >= ny or k >= nz:
                continue
            count += 1
            if grid.touched[i, j, k] != number and d * d <= two:
                grid.touched[i, j, k] = number  # a second pixel must end here: a single one may be noise
                continue
            grid.marked[i, j, k] = number
            grid.passed[i, j, k] = 0
            if grid.state[i, j, k] != OCCUPIED:
                grid.state[i, j, k] = OCCUPIED
                grid.changed[i // BLOCK, j // BLOCK, k // BLOCK] = 1
    return count


@kernel
def filled(depth: Depth, out: Depth) -> None:
    """Write to `out` the depths (h, w) with single holes closed: a pixel without a depth, most of whose neighbours have one, gets
    the least of these.
    """
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            out[v, u] = depth[v, u]
            if depth[v, u] != 0.0:
                continue
            known, least = 0, np.float32(np.inf)
            for row in range(max(0, v - 1), min(height, v + 2)):
                for column in range(max(0, u - 1), min(width, u + 2)):
                    if depth[row, column] != 0.0:
                        known += 1
                        least = min(least, depth[row, column])
            if known >= _KNOWN:
                out[v, u] = least


@kernel
def least_depths(depth: Depth) -> Depth:
    """The least depth in squares of 2, 4, 8 ... pixels, one below the other, (levels, h, w): level l holds in (v, u) that of the
    square of 2^l pixels from (v * 2^l, u * 2^l) on; level 0 is `depth` itself.
    """
    height, width = depth.shape
    levels = 1
    while (1 << levels) < max(height, width):
        levels += 1
    out = np.zeros((levels, height, width), np.float32)
    out[0] = depth
    for level in range(1, levels):
        rows, columns = (height + (1 << level) - 1) >> level, (width + (1 << level) - 1) >> level
        below_rows, below_columns = (
            (height + (1 << (level - 1)) - 1) >> (level - 1),
            (width + (1 << (level - 1)) - 1) >> (level - 1),
        )
        for v in range(rows):
            for u in range(columns):
                least = np.float32(np.inf)
                for dv in range(2):
                    for du in range(2):
                        if 2 * v + dv < below_rows and 2 * u + du < below_columns:
                            least = min(least, out[level - 1, 2 * v + dv, 2 * u + du])
                out[level, v, u] = least
    return out


@kernel
def clear(grid: Grid, least: Depth, view: View, number: int, unseen: bool) -> int:
    """Free the occupied voxels that PASSES images have seen through, except those that image `number` marked; with `unseen` also those that nothing was
    known of, at once. `least` as `least_depths` has it. Returns how many occupied ones it freed.

    A voxel is seen through if every pixel on which it can appear is deeper than all of it; so what is beside it in the
    image keeps it, and never the other way around.
    """
    nx, ny, nz = grid.state.shape
    levels, height, width = least.shape
    turn, place, size = view.turn, view.place, grid.resolution
    # How far a voxel reaches along the axes of the camera, and from its centre.
    right_of = 0.5 * size * (abs(turn[0, 0]) + abs(turn[1, 0]) + abs(turn[2, 0]))
    below = 0.5 * size * (abs(turn[0, 1]) + abs(turn[1, 1]) + abs(turn[2, 1]))
    behind = 0.5 * size * (abs(turn[0, 2]) + abs(turn[1, 2]) + abs(turn[2, 2]))
    around = 0.5 * math.sqrt(3.0) * size
    freed = 0
    for i in range(nx):
        x = grid.origin[0] + i * size - place[0]
        for j in range(ny):
            y = grid.origin[1] + j * size - place[1]
            for k in range(nz):
                state = grid.state[i, j, k]
                if (
                    state == FREE
                    or (state == UNSEEN and not unseen)
                    or (state == OCCUPIED and grid.marked[i, j, k] == number)
                ):
                    continue
                z = grid.origin[2] + k * size - place[2]
                c = turn[0, 2] * x + turn[1, 2] * y + turn[2, 2] * z
                if view.spherical:
                    across = turn[0, 0] * x + turn[1, 0] * y + turn[2, 0] * z
                    down = turn[0, 1] * x + turn[1, 1] * y + turn[2, 1] * z
                    away, level_distance = math.sqrt(across * across + down * down + c * c), math.hypot(across, c)
                    nearest, farthest = away - around, away + around
                    if nearest < view.near or farthest >= view.far or level_distance <= around:
                        continue
                    u, v = view.cx + view.fx * math.atan2(across, c), view.cy + view.fy * math.asin(down / away)
                    wide, high = view.fx * math.asin(around / level_distance), view.fy * math.asin(around / away)
                else:
                    nearest, farthest = c - behind, c + behind
                    if nearest < view.near or farthest >= view.far:
                        continue
                    a = (turn[0, 0] * x + turn[1, 0] * y + turn[2, 0] * z) / c
                    b = (turn[0, 1] * x + turn[1, 1] * y + turn[2, 1] * z) / c
                    u, v = view.cx + view.fx * a, view.cy + view.fy * b
                    wide = view.fx * (right_of + abs(a) * behind) / nearest
                    high = view.fy * (below + abs(b) * behind) / nearest
                left, right = math.floor(u - wide), math.ceil(u + wide)
                top, bottom = math.floor(v - high), math.ceil(v + high)
                if left < 0 or top < 0 or right >= width or bottom >= height:
                    continue
                level = 0
                while level < levels - 1 and (_MIN_SQUARES_PER_VOXEL << level) <= min(right - left, bottom - top):
                    level += 1
                deeper = True
                for row in range(top >> level, (bottom >> level) + 1):
                    for column in range(left >> level, (right >> level) + 1):
                        if least[level, row, column] <= farthest:
                            deeper = False
                            break
                    if not deeper:
                        break
                if deeper:
                    if state == OCCUPIED and grid.passed[i, j, k] < PASSES - 1:
                        grid.passed[i, j, k] += 1
                        continue
                    grid.state[i, j, k] = FREE
                    grid.changed[i // BLOCK, j // BLOCK, k // BLOCK] = 1
                    if state == OCCUPIED:
                        freed += 1
    return freed
