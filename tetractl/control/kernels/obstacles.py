"""Whether robots are in obstacles, and how deep: the compiled twin of `tetractl.core.shape`.

Obstacles are numbers: `rows` and `walls` of `tetractl.core.obstacles`, which number first the
shapes and then the walls. Every shape runs the same code.
"""

import math

from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import INLINE_FAST

# Columns of a row.
RADIUS = 0
"""Radius by which the polygon is grown [length unit]."""
CORNERS = 1
"""Number of corners of the polygon."""
LEFT = 2
"""Least x of the box around the shape [length unit]."""
BOTTOM = 3
"""Least y of the box [length unit]."""
RIGHT = 4
"""Greatest x of the box [length unit]."""
TOP = 5
"""Greatest y of the box [length unit]."""
FIRST = 6
"""x of the first corner, then y, then x of the next [length unit]."""

HALF_MORE = 0.5000001
"""Half, and a little more than rounding takes: a box must not be too small."""
ON_EDGE = 1e-9
"""Distance from an edge, over the coordinates, below which a point is on it."""


@compiled(**INLINE_FAST)
def gap2(x, y, ex, ey):
    """Return the squared distance of (x, y) to the segment from (0, 0) to (ex, ey)."""
    length2 = ex * ex + ey * ey
    along = max(0.0, min((x * ex + y * ey) / (length2 if length2 > 0.0 else 1.0), 1.0))
    qx = x - along * ex
    qy = y - along * ey
    return qx * qx + qy * qy


@compiled(**INLINE_FAST)
def touches(row, x0, y0, x1, y1):
    """Return whether the segment from (x0, y0) to (x1, y1) touches the shape of a row."""
    last_corner = FIRST + 2 * int(row[CORNERS]) - 2
    reach = row[RADIUS] * row[RADIUS]
    inside = False
    dx = x1 - x0
    dy = y1 - y0
    ax = row[last_corner]
    ay = row[last_corner + 1]
    for k in range(FIRST, last_corner + 1, 2):
        bx = row[k]
        by = row[k + 1]
        ex = bx - ax
        ey = by - ay
        if gap2(x1 - ax, y1 - ay, ex, ey) <= reach or gap2(x0 - ax, y0 - ay, ex, ey) <= reach:
            return True
        if gap2(bx - x0, by - y0, dx, dy) <= reach:
            return True
        side_of_0 = ex * (y0 - ay) - ey * (x0 - ax)
        side_of_1 = ex * (y1 - ay) - ey * (x1 - ax)
        if (ay > y0) != (by > y0) and (side_of_0 > 0) == (by > ay):
            inside = not inside
        side_of_a = dx * (ay - y0) - dy * (ax - x0)
        side_of_b = dx * (by - y0) - dy * (bx - x0)
        if side_of_0 * side_of_1 < 0 and side_of_a * side_of_b < 0:
            return True
        ax = bx
        ay = by
    return inside


@compiled(**INLINE_FAST)
def nearest(row, x, y):
    """Return the distance of (x, y) to the shape of a row, negative inside, and the unit vector
    along which it grows; at an edge of the polygon, the edge's normal.
    """
    last = FIRST + 2 * int(row[CORNERS]) - 2
    inside = False
    least = math.inf
    normal_x = 0.0
    normal_y = 0.0
    out_x = 1.0
    out_y = 0.0
    ax = row[last]
    ay = row[last + 1]
    for k in range(FIRST, last + 1, 2):
        bx = row[k]
        by = row[k + 1]
        ex = bx - ax
        ey = by - ay
        px = x - ax
        py = y - ay
        if (ay > y) != (by > y) and (ex * py - ey * px > 0) == (by > ay):
            inside = not inside
        length2 = ex * ex + ey * ey
        along = max(0.0, min((px * ex + py * ey) / (length2 if length2 > 0.0 else 1.0), 1.0))
        qx = px - along * ex
        qy = py - along * ey
        if qx * qx + qy * qy < least:
            least = qx * qx + qy * qy
            out_x = qx
            out_y = qy
            normal_x = ey
            normal_y = -ex
        ax = bx
        ay = by
    away = math.sqrt(least)
    if not away > ON_EDGE * (abs(x) + abs(y)):
        out_x = normal_x
        out_y = normal_y
        if normal_x == 0.0 and normal_y == 0.0:
            out_x = 1.0
    elif inside:
        out_x = -out_x
        out_y = -out_y
    size = math.sqrt(out_x * out_x + out_y * out_y)
    return (-away if inside else away) - row[RADIUS], out_x / size, out_y / size


@compiled(**INLINE_FAST)
def count_hits(problem, x, y, i, room):
    """Add 1 to hits[i, n] of the room if robot i of particle n has touched an obstacle.

    The robot is at x, y (N, P); if ways are `swept`, it came there from x_before, y_before (P,) of
    the room. Its gap and near (P,) are scratch.
    """
    walls = problem.walls
    swept = problem.swept
    x0 = room.x_before
    y0 = room.y_before
    gap = room.gap
    near = room.near
    particles = gap.size
    for n in range(particles):
        gap[n] = 1.0
    if walls.size:
        left = walls[0]
        bottom = walls[1]
        right = walls[2]
        top = walls[3]
        for n in range(particles):
            across = min(x[i, n] - left, right - x[i, n])
            gap[n] = min(across, min(y[i, n] - bottom, top - y[i, n]))
        for n in range(particles if swept else 0):
            across = min(x0[n] - left, right - x0[n])
            gap[n] = min(gap[n], min(across, min(y0[n] - bottom, top - y0[n])))
    for o in range(problem.rows.shape[0]):
        # the box around the shape, tested for all particles at once, leaves few to be tested
        row = problem.rows[o]
        in_box = 0.0
        mid_x = (row[LEFT] + row[RIGHT]) / 2.0
        mid_y = (row[BOTTOM] + row[TOP]) / 2.0
        half_x = (row[RIGHT] - row[LEFT]) * HALF_MORE
        half_y = (row[TOP] - row[BOTTOM]) * HALF_MORE
        if swept:
            for n in range(particles):
                hx = (x[i, n] - x0[n]) / 2.0
                hy = (y[i, n] - y0[n]) / 2.0
                mx = x0[n] + hx - mid_x
                my = y0[n] + hy - mid_y
                off_box = max(abs(mx) - abs(hx) - half_x, abs(my) - abs(hy) - half_y)
                across = abs(hx * my - hy * mx) - (half_x * abs(hy) + half_y * abs(hx))
                near[n] = max(off_box, across)
                in_box += 1.0 if near[n] <= 0 else 0.0
        else:
            for n in range(particles):
                near[n] = max(abs(x[i, n] - mid_x) - half_x, abs(y[i, n] - mid_y) - half_y)
                in_box += 1.0 if near[n] <= 0 else 0.0
        if in_box > 0:
            for n in range(particles):
                if near[n] <= 0 and gap[n] > 0:
                    ax, ay = (x0[n], y0[n]) if swept else (x[i, n], y[i, n])
                    if touches(row, ax, ay, x[i, n], y[i, n]):
                        gap[n] = 0.0
    for n in range(particles):
        room.hits[i, n] += 1.0 if gap[n] <= 0 else 0.0


@compiled(**INLINE_FAST)
def find_deepest(problem, floor, room):
    """Find each robot's deepest position in each obstacle, along the room's path of L signals.

    Its depths (N, O) [length unit] are `floor` if no position is deeper; deepest (N, O) is the
    index of the first deepest position. near (M,) is scratch.
    """
    length = room.trial.size
    shapes = problem.rows.shape[0]
    for i in range(len(problem.robots)):
        x = room.path.x[i]
        y = room.path.y[i]
        for o in range(shapes):
            row = problem.rows[o]
            depth_most = floor
            deepest = 0
            for j in range(room.near.size):
                beside = max(row[LEFT] - x[j], x[j] - row[RIGHT])
                room.near[j] = -max(beside, max(row[BOTTOM] - y[j], y[j] - row[TOP]))
            for j in range(length):
                if room.near[j] > depth_most:
                    depth = -nearest(row, x[j], y[j])[0]
                    if depth > depth_most:
                        depth_most = depth
                        deepest = j
            room.depths[i, o] = depth_most
            room.deepest[i, o] = deepest
        for w in range(problem.walls.size):
            side = -1.0 if w < 2 else 1.0
            along = x if w % 2 == 0 else y
            depth_most = floor
            deepest = 0
            for j in range(length):
                depth = side * (along[j] - problem.walls[w])
                if depth > depth_most:
                    depth_most = depth
                    deepest = j
            room.depths[i, shapes + w] = depth_most
            room.deepest[i, shapes + w] = deepest


@compiled(**INLINE_FAST)
def outward(rows, walls, o, x, y):
    """Return the unit vector from (x, y) out of obstacle o."""
    if o < rows.shape[0]:
        _, east, north = nearest(rows[o], x, y)
        return east, north
    w = o - rows.shape[0]
    side = 1.0 if w < 2 else -1.0
    return (side, 0.0) if w % 2 == 0 else (0.0, side)
