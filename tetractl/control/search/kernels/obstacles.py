"""Compiled tests of whether robots are in obstacles, and how deep.

The geometry of segments is that of `tetractl.core.shape`, compiled. Kernels take obstacles as
`ObstacleArrays`. Obstacle o is shape o if o < M, and otherwise wall o - M; the walls are LEFT,
BOTTOM, RIGHT and TOP. All shapes are polygons with a radius and run the same code. The `corners` of
one shape are (K, 2); the first `count` are in use.
"""

import math
from typing import NamedTuple

from tetractl.core import shape
from tetractl.core.obstacles import BOTTOM, LEFT, RIGHT, TOP, Obstacles
from tetractl.core.poses import Floats, Integers
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import INLINE_FAST, PART_FAST, exact

offset_from_segment = exact(shape.offset_from_segment)
squared_distance_of_segments = exact(shape.squared_distance_of_segments)
ray_crosses = exact(shape.ray_crosses)

HALF_MORE = 0.5000001
"""Half of a box's size, enlarged by more than rounding errors: a box must not be too small."""
ON_EDGE = 1e-9
"""Distance from an edge below which a point is on it, as a fraction of its coordinates."""


class ObstacleArrays(NamedTuple):
    """The `Obstacles` of a problem as arrays that compiled code can read.

    There are M shapes. Each is a polygon with at most K corners (a circle has one), grown by a
    radius. Lengths are in the spec's unit.
    """

    corners: Floats  # (M, K, 2) x, y of the corners of each polygon
    corner_counts: Integers  # (M,)
    radii: Floats  # (M,) of the shapes
    low: Floats  # (M, 2) least x, y of the corners
    high: Floats  # (M, 2) greatest x, y of the corners
    walls: Floats  # (4,) or, for none, (0,)


def arrays_of(obstacles: Obstacles) -> ObstacleArrays:
    """Convert obstacles to arrays for compiled code. Repeated calls share the arrays."""
    return ObstacleArrays(
        corners=obstacles.corners,
        corner_counts=obstacles.corner_counts,
        radii=obstacles.radii,
        low=obstacles.corners_min,
        high=obstacles.corners_max,
        walls=obstacles.walls,
    )


@compiled(**INLINE_FAST)
def box(obstacles, o):
    """Return left, bottom, right and top of the smallest box around shape o, with its radius."""
    radius = obstacles.radii[o]
    left = obstacles.low[o, 0] - radius
    bottom = obstacles.low[o, 1] - radius
    right = obstacles.high[o, 0] + radius
    top = obstacles.high[o, 1] + radius
    return left, bottom, right, top


@compiled(**INLINE_FAST)
def touches(corners, count, radius, x0, y0, x1, y1):
    """Check whether a segment touches a shape.

    Args:
        corners: Corners of the shape, shape (K, 2).
        count: Number of corners in use.
        radius: Radius of the shape [length unit].
        x0: x of the segment's start.
        y0: y of the segment's start.
        x1: x of the segment's end.
        y1: y of the segment's end.
    """
    reach = radius * radius
    inside = False
    ax = corners[count - 1, 0]
    ay = corners[count - 1, 1]
    for k in range(count):
        bx = corners[k, 0]
        by = corners[k, 1]
        if squared_distance_of_segments(x0, y0, x1, y1, ax, ay, bx, by) <= reach:
            return True
        inside = inside != ray_crosses(x0, y0, ax, ay, bx, by)
        ax = bx
        ay = by
    return inside


@compiled(**INLINE_FAST)
def nearest(corners, count, radius, x, y):
    """Compute the distance of a point to a shape, and the direction in which it grows.

    Args:
        corners: Corners of the shape, shape (K, 2).
        count: Number of corners in use.
        radius: Radius of the shape [length unit].
        x: x of the point.
        y: y of the point.

    Returns:
        The distance, negative inside, and the x and y of the unit vector. On an edge of the
        polygon, the vector is the edge's normal.
    """
    inside = False
    least2 = math.inf
    normal_x = 0.0
    normal_y = 0.0
    out_x = 1.0
    out_y = 0.0
    ax = corners[count - 1, 0]
    ay = corners[count - 1, 1]
    for k in range(count):
        bx = corners[k, 0]
        by = corners[k, 1]
        inside = inside != ray_crosses(x, y, ax, ay, bx, by)
        off_x, off_y = offset_from_segment(x, y, ax, ay, bx, by)
        if off_x * off_x + off_y * off_y < least2:
            least2 = off_x * off_x + off_y * off_y
            out_x = off_x
            out_y = off_y
            normal_x = by - ay
            normal_y = ax - bx
        ax = bx
        ay = by
    away = math.sqrt(least2)
    if not away > ON_EDGE * (abs(x) + abs(y)):
        out_x = normal_x
        out_y = normal_y
        if normal_x == 0.0 and normal_y == 0.0:
            out_x = 1.0
    elif inside:
        out_x = -out_x
        out_y = -out_y
    size = math.sqrt(out_x * out_x + out_y * out_y)
    return (-away if inside else away) - radius, out_x / size, out_y / size


class Contacts(NamedTuple):
    """Working arrays to find out what robots touch along P paths, or at P points of one path."""

    hits: Floats
    """How often each of N robots touches an obstacle or another robot, shape (N, P)."""
    x_before: Floats
    """x of one robot before the present signal [length unit], shape (P,)."""
    y_before: Floats
    """y of one robot before the present signal [length unit], shape (P,)."""
    clearance: Floats
    """How far one robot is inside the walls; 0 once it touches anything else, shape (P,)."""
    box_distance: Floats
    """Distance of one robot from the box around an obstacle [length unit], shape (P,)."""


@compiled(**PART_FAST)
def count_hits(problem, x, y, i, contacts):
    """Count where robot i has touched an obstacle: add 1 to contacts.hits[i, n].

    Particle n is one of P sequences of signals that are simulated at once.

    Args:
        problem: The problem, a `FlatProblem`.
        x: x of the robots, shape (N, P).
        y: y of the robots, shape (N, P).
        i: Index of the robot.
        contacts: The working arrays. If paths are `swept`, x_before and y_before hold where the
            robot came from. `clearance` and `box_distance` are overwritten.
    """
    obstacles = problem.obstacles
    walls = obstacles.walls
    swept = problem.swept
    x0 = contacts.x_before
    y0 = contacts.y_before
    clearance = contacts.clearance
    box_distance = contacts.box_distance
    particles = clearance.size
    for n in range(particles):
        clearance[n] = 1.0
    if walls.size:
        left = walls[LEFT]
        bottom = walls[BOTTOM]
        right = walls[RIGHT]
        top = walls[TOP]
        for n in range(particles):
            across = min(x[i, n] - left, right - x[i, n])
            clearance[n] = min(across, min(y[i, n] - bottom, top - y[i, n]))
        for n in range(particles if swept else 0):
            across = min(x0[n] - left, right - x0[n])
            clearance[n] = min(clearance[n], min(across, min(y0[n] - bottom, top - y0[n])))
    for o in range(obstacles.radii.size):
        # the box around the shape, tested for all particles at once, leaves few to be tested
        corners = obstacles.corners[o]
        count = obstacles.corner_counts[o]
        radius = obstacles.radii[o]
        box_left, box_bottom, box_right, box_top = box(obstacles, o)
        in_box = 0.0
        mid_x = (box_left + box_right) / 2.0
        mid_y = (box_bottom + box_top) / 2.0
        half_x = (box_right - box_left) * HALF_MORE
        half_y = (box_top - box_bottom) * HALF_MORE
        if swept:
            for n in range(particles):
                hx = (x[i, n] - x0[n]) / 2.0
                hy = (y[i, n] - y0[n]) / 2.0
                mx = x0[n] + hx - mid_x
                my = y0[n] + hy - mid_y
                off_box = max(abs(mx) - abs(hx) - half_x, abs(my) - abs(hy) - half_y)
                across = abs(hx * my - hy * mx) - (half_x * abs(hy) + half_y * abs(hx))
                box_distance[n] = max(off_box, across)
                in_box += 1.0 if box_distance[n] <= 0 else 0.0
        else:
            for n in range(particles):
                box_distance[n] = max(abs(x[i, n] - mid_x) - half_x, abs(y[i, n] - mid_y) - half_y)
                in_box += 1.0 if box_distance[n] <= 0 else 0.0
        if in_box > 0:
            for n in range(particles):
                if box_distance[n] <= 0 and clearance[n] > 0:
                    ax, ay = (x0[n], y0[n]) if swept else (x[i, n], y[i, n])
                    if touches(corners, count, radius, ax, ay, x[i, n], y[i, n]):
                        clearance[n] = 0.0
    for n in range(particles):
        contacts.hits[i, n] += 1.0 if clearance[n] <= 0 else 0.0


@compiled(**PART_FAST)
def find_deepest(problem, floor, room):
    """Find each robot's deepest position in each obstacle along a path.

    Args:
        problem: The problem, a `FlatProblem`.
        floor: Depth that is reported if no position is deeper [length unit].
        room: The working arrays. `path` holds the path, `depths` (N, O) and `deepest` (N, O) are
            filled with the depth and with the index of the first deepest position. `box_depth`
            is overwritten.
    """
    length = room.trial.size
    obstacles = problem.obstacles
    walls = obstacles.walls
    shapes = obstacles.radii.size
    for i in range(len(problem.robots)):
        x = room.path.x[i]
        y = room.path.y[i]
        for o in range(shapes):
            corners = obstacles.corners[o]
            count = obstacles.corner_counts[o]
            radius = obstacles.radii[o]
            box_left, box_bottom, box_right, box_top = box(obstacles, o)
            depth_most = floor
            deepest = 0
            for j in range(room.box_depth.size):
                beside = max(box_left - x[j], x[j] - box_right)
                room.box_depth[j] = -max(beside, max(box_bottom - y[j], y[j] - box_top))
            for j in range(length):
                if room.box_depth[j] > depth_most:
                    depth = -nearest(corners, count, radius, x[j], y[j])[0]
                    if depth > depth_most:
                        depth_most = depth
                        deepest = j
            room.depths[i, o] = depth_most
            room.deepest[i, o] = deepest
        for w in range(walls.size):
            depth_most = floor
            deepest = 0
            for j in range(length):
                depth = -wall_distance(walls, w, x[j], y[j])
                if depth > depth_most:
                    depth_most = depth
                    deepest = j
            room.depths[i, shapes + w] = depth_most
            room.deepest[i, shapes + w] = deepest


@compiled(**INLINE_FAST)
def wall_distance(walls, w, x, y):
    """Compute the distance of a point to a wall, negative beyond it.

    Args:
        walls: The walls.
        w: Which wall: LEFT, BOTTOM, RIGHT or TOP.
        x: x of the point.
        y: y of the point.
    """
    if w == LEFT:
        return x - walls[LEFT]
    if w == BOTTOM:
        return y - walls[BOTTOM]
    if w == RIGHT:
        return walls[RIGHT] - x
    return walls[TOP] - y


@compiled(**INLINE_FAST)
def outward(obstacles, o, x, y):
    """Compute the unit vector in which a point gets out of an obstacle on the shortest path.

    Args:
        obstacles: The obstacles and walls.
        o: Index of the obstacle.
        x: x of the point.
        y: y of the point.

    Returns:
        x and y of the vector.
    """
    shapes = obstacles.radii.size
    if o < shapes:
        corners = obstacles.corners[o]
        _, east, north = nearest(corners, obstacles.corner_counts[o], obstacles.radii[o], x, y)
        return east, north
    w = o - shapes
    if w == LEFT:
        return 1.0, 0.0
    if w == BOTTOM:
        return 0.0, 1.0
    if w == RIGHT:
        return -1.0, 0.0
    return 0.0, -1.0
