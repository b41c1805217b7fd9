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
    radius_squared = radius * radius
    inside = False
    ax = corners[count - 1, 0]
    ay = corners[count - 1, 1]
    for k in range(count):
        bx = corners[k, 0]
        by = corners[k, 1]
        if squared_distance_of_segments(x0, y0, x1, y1, ax, ay, bx, by) <= radius_squared:
            return True
        inside = inside != ray_crosses(x0, y0, ax, ay, bx, by)
        ax = bx
        ay = by
    return inside


@compiled(**INLINE_FAST)
def distance_and_normal(corners, count, radius, x, y):
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
    min_squared = math.inf
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
        if off_x * off_x + off_y * off_y < min_squared:
            min_squared = off_x * off_x + off_y * off_y
            out_x = off_x
            out_y = off_y
            normal_x = by - ay
            normal_y = ax - bx
        ax = bx
        ay = by
    edge_distance = math.sqrt(min_squared)
    if not edge_distance > ON_EDGE * (abs(x) + abs(y)):
        out_x = normal_x
        out_y = normal_y
        if normal_x == 0.0 and normal_y == 0.0:
            out_x = 1.0
    elif inside:
        out_x = -out_x
        out_y = -out_y
    size = math.sqrt(out_x * out_x + out_y * out_y)
    return (-edge_distance if inside else edge_distance) - radius, out_x / size, out_y / size


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
                half_dx = (x[i, n] - x0[n]) / 2.0
                half_dy = (y[i, n] - y0[n]) / 2.0
                middle_x = x0[n] + half_dx - mid_x
                middle_y = y0[n] + half_dy - mid_y
                off_box = max(
                    abs(middle_x) - abs(half_dx) - half_x, abs(middle_y) - abs(half_dy) - half_y
                )
                across = abs(half_dx * middle_y - half_dy * middle_x) - (
                    half_x * abs(half_dy) + half_y * abs(half_dx)
                )
                box_distance[n] = max(off_box, across)
                in_box += 1.0 if box_distance[n] <= 0 else 0.0
        else:
            for n in range(particles):
                box_distance[n] = max(abs(x[i, n] - mid_x) - half_x, abs(y[i, n] - mid_y) - half_y)
                in_box += 1.0 if box_distance[n] <= 0 else 0.0
        if in_box > 0:
            for n in range(particles):
                if box_distance[n] <= 0 and clearance[n] > 0:
                    start_x, start_y = (x0[n], y0[n]) if swept else (x[i, n], y[i, n])
                    if touches(corners, count, radius, start_x, start_y, x[i, n], y[i, n]):
                        clearance[n] = 0.0
    for n in range(particles):
        contacts.hits[i, n] += 1.0 if clearance[n] <= 0 else 0.0


@compiled(**PART_FAST)
def find_deepest(problem, floor, workspace):
    """Find each robot's deepest position in each obstacle along a path.

    Args:
        problem: The problem, a `FlatProblem`.
        floor: Depth that is reported if no position is deeper [length unit].
        workspace: The working arrays. `path` holds the path. `depths` (N, O) is filled with the
            depth, and `deepest_signal` (N, O) with the index of the first deepest position.
            `box_depth` is overwritten.
    """
    length = workspace.trial.size
    obstacles = problem.obstacles
    walls = obstacles.walls
    shapes = obstacles.radii.size
    for i in range(len(problem.robots)):
        x = workspace.path.x[i]
        y = workspace.path.y[i]
        for o in range(shapes):
            corners = obstacles.corners[o]
            count = obstacles.corner_counts[o]
            radius = obstacles.radii[o]
            box_left, box_bottom, box_right, box_top = box(obstacles, o)
            max_depth = floor
            deepest_signal = 0
            for j in range(workspace.box_depth.size):
                beside = max(box_left - x[j], x[j] - box_right)
                workspace.box_depth[j] = -max(beside, max(box_bottom - y[j], y[j] - box_top))
            for j in range(length):
                if workspace.box_depth[j] > max_depth:
                    depth = -distance_and_normal(corners, count, radius, x[j], y[j])[0]
                    if depth > max_depth:
                        max_depth = depth
                        deepest_signal = j
            workspace.depths[i, o] = max_depth
            workspace.deepest_signal[i, o] = deepest_signal
        for w in range(walls.size):
            max_depth = floor
            deepest_signal = 0
            for j in range(length):
                depth = -wall_distance(walls, w, x[j], y[j])
                if depth > max_depth:
                    max_depth = depth
                    deepest_signal = j
            workspace.depths[i, shapes + w] = max_depth
            workspace.deepest_signal[i, shapes + w] = deepest_signal


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
        _, east, north = distance_and_normal(
            corners, obstacles.corner_counts[o], obstacles.radii[o], x, y
        )
        return east, north
    w = o - shapes
    if w == LEFT:
        return 1.0, 0.0
    if w == BOTTOM:
        return 0.0, 1.0
    if w == RIGHT:
        return -1.0, 0.0
    return 0.0, -1.0
