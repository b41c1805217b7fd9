"""Whether robots are in obstacles, and how deep: the compiled twin of `tetractl.core.shape`.

Obstacles are numbers: `rows` and `walls` of `tetractl.model.obstacles`, which number first the
shapes and then the walls. Every shape runs the same code.
"""

import math

from tetractl.core.kernels.kernel_cache import compiled
from tetractl.core.kernels.kernel_options import INLINE_FAST

RADIUS, CORNERS, LEFT, BOTTOM, RIGHT, TOP, FIRST = range(7)  # columns of a row


@compiled(**INLINE_FAST)
def gap2(x, y, ex, ey):
    """Return the squared distance of (x, y) to the segment from (0, 0) to (ex, ey)."""
    length2 = ex * ex + ey * ey
    along = max(0.0, min((x * ex + y * ey) / (length2 if length2 > 0.0 else 1.0), 1.0))
    qx, qy = x - along * ex, y - along * ey
    return qx * qx + qy * qy


@compiled(**INLINE_FAST)
def touches(row, x0, y0, x1, y1):
    """Return whether the segment from (x0, y0) to (x1, y1) touches the shape of a row."""
    last, reach = FIRST + 2 * int(row[CORNERS]) - 2, row[RADIUS] * row[RADIUS]
    inside, dx, dy = False, x1 - x0, y1 - y0
    ax, ay = row[last], row[last + 1]
    for k in range(FIRST, last + 1, 2):
        bx, by = row[k], row[k + 1]
        ex, ey = bx - ax, by - ay
        if gap2(x1 - ax, y1 - ay, ex, ey) <= reach or gap2(x0 - ax, y0 - ay, ex, ey) <= reach:
            return True
        if gap2(bx - x0, by - y0, dx, dy) <= reach:
            return True
        start, end = ex * (y0 - ay) - ey * (x0 - ax), ex * (y1 - ay) - ey * (x1 - ax)
        if (ay > y0) != (by > y0) and (start > 0) == (by > ay):
            inside = not inside
        left, right = dx * (ay - y0) - dy * (ax - x0), dx * (by - y0) - dy * (bx - x0)
        if start * end < 0 and left * right < 0:
            return True
        ax, ay = bx, by
    return inside


@compiled(**INLINE_FAST)
def nearest(row, x, y):
    """Return the distance of (x, y) to the shape of a row, negative inside, and the unit vector
    along which it grows; at an edge of the polygon, the edge's normal.
    """
    last = FIRST + 2 * int(row[CORNERS]) - 2
    inside, least, nx, ny, ox, oy = False, math.inf, 0.0, 0.0, 1.0, 0.0
    ax, ay = row[last], row[last + 1]
    for k in range(FIRST, last + 1, 2):
        bx, by = row[k], row[k + 1]
        ex, ey, px, py = bx - ax, by - ay, x - ax, y - ay
        if (ay > y) != (by > y) and (ex * py - ey * px > 0) == (by > ay):
            inside = not inside
        length2 = ex * ex + ey * ey
        along = max(0.0, min((px * ex + py * ey) / (length2 if length2 > 0.0 else 1.0), 1.0))
        qx, qy = px - along * ex, py - along * ey
        if qx * qx + qy * qy < least:
            least, ox, oy, nx, ny = qx * qx + qy * qy, qx, qy, ey, -ex
        ax, ay = bx, by
    away = math.sqrt(least)
    if not away > 1e-9 * (abs(x) + abs(y)):
        ox, oy = nx, ny
        if nx == 0.0 and ny == 0.0:
            ox = 1.0
    elif inside:
        ox, oy = -ox, -oy
    size = math.sqrt(ox * ox + oy * oy)
    return (-away if inside else away) - row[RADIUS], ox / size, oy / size


@compiled(**INLINE_FAST)
def count_hits(rows, walls, x0, y0, x, y, i, swept, gap, near, hits):
    """Add 1 to hits[i, n] if robot i of particle n has touched an obstacle.

    The robot is at x, y (N, P); if `swept`, it came there from x0, y0 (P,). gap and near (P,) are
    scratch arrays.
    """
    for n in range(gap.size):
        gap[n] = 1.0
    if walls.size:
        left, bottom, right, top = walls[0], walls[1], walls[2], walls[3]
        for n in range(gap.size):
            across = min(x[i, n] - left, right - x[i, n])
            gap[n] = min(across, min(y[i, n] - bottom, top - y[i, n]))
        for n in range(gap.size if swept else 0):
            across = min(x0[n] - left, right - x0[n])
            gap[n] = min(gap[n], min(across, min(y0[n] - bottom, top - y0[n])))
    for o in range(rows.shape[0]):
        # the box around the shape, tested for all particles at once, leaves few to be tested
        row, some = rows[o], 0.0
        mid_x, mid_y = (row[LEFT] + row[RIGHT]) / 2.0, (row[BOTTOM] + row[TOP]) / 2.0
        half_x = (row[RIGHT] - row[LEFT]) * 0.5000001
        half_y = (row[TOP] - row[BOTTOM]) * 0.5000001
        if swept:
            for n in range(gap.size):
                hx, hy = (x[i, n] - x0[n]) / 2.0, (y[i, n] - y0[n]) / 2.0
                mx, my = x0[n] + hx - mid_x, y0[n] + hy - mid_y
                beside = max(abs(mx) - abs(hx) - half_x, abs(my) - abs(hy) - half_y)
                across = abs(hx * my - hy * mx) - (half_x * abs(hy) + half_y * abs(hx))
                near[n] = max(beside, across)
                some += 1.0 if near[n] <= 0 else 0.0
        else:
            for n in range(gap.size):
                near[n] = max(abs(x[i, n] - mid_x) - half_x, abs(y[i, n] - mid_y) - half_y)
                some += 1.0 if near[n] <= 0 else 0.0
        if some > 0:
            for n in range(gap.size):
                if near[n] <= 0 and gap[n] > 0:
                    ax, ay = (x0[n], y0[n]) if swept else (x[i, n], y[i, n])
                    if touches(row, ax, ay, x[i, n], y[i, n]):
                        gap[n] = 0.0
    for n in range(gap.size):
        hits[i, n] += 1.0 if gap[n] <= 0 else 0.0


@compiled(**INLINE_FAST)
def find_deepest(rows, walls, path, length, floor, near, depths, where):
    """Find each robot's deepest position in each obstacle.

    path (2, N, M): only the first `length` positions count. depths (N, O) [length unit] are `floor`
    if no position is deeper; where (N, O) is the index of the first deepest position. near (M,) is
    a scratch array.
    """
    shapes = rows.shape[0]
    for i in range(path.shape[1]):
        x, y = path[0, i], path[1, i]
        for o in range(shapes):
            row, deepest, at = rows[o], floor, 0
            for j in range(near.size):
                beside = max(row[LEFT] - x[j], x[j] - row[RIGHT])
                near[j] = -max(beside, max(row[BOTTOM] - y[j], y[j] - row[TOP]))
            for j in range(length):
                if near[j] > deepest:
                    depth = -nearest(row, x[j], y[j])[0]
                    if depth > deepest:
                        deepest, at = depth, j
            depths[i, o], where[i, o] = deepest, at
        for w in range(walls.size):
            side, along, deepest, at = -1.0 if w < 2 else 1.0, path[w % 2, i], floor, 0
            for j in range(length):
                depth = side * (along[j] - walls[w])
                if depth > deepest:
                    deepest, at = depth, j
            depths[i, shapes + w], where[i, shapes + w] = deepest, at


@compiled(**INLINE_FAST)
def outward(rows, walls, o, x, y):
    """Return the unit vector from (x, y) out of obstacle o."""
    if o < rows.shape[0]:
        _, east, north = nearest(rows[o], x, y)
        return east, north
    w = o - rows.shape[0]
    side = 1.0 if w < 2 else -1.0
    return (side, 0.0) if w % 2 == 0 else (0.0, side)
