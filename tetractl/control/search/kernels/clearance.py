"""Compiled distances of robots from obstacles and from each other, and tests for contact on a path.

The code is compiled, because a controller needs these numbers at every control step
(`tetractl.control.search.margins` and `discs`). Distances [length unit] equal those of
`tetractl.core.obstacles` to the bit. Obstacles are `ObstacleArrays`; obstacle o is a shape or a
wall. x, y (P,) are points. A path (M, N, 3) holds the x, y and heading of N robots at M moments,
with straight segments in between.
"""

import math

from tetractl.control.search.kernels.elementary import hypot
from tetractl.control.search.kernels.obstacles import (
    box,
    distance_and_normal,
    touches,
    wall_distance,
)
from tetractl.tools.kernels.kernel_cache import compiled
from tetractl.tools.kernels.kernel_options import ENTRY, INLINE_EXACT


@compiled(**INLINE_EXACT)
def _distance(obstacles, o, x, y):
    """Compute the distance of point (x, y) to obstacle o, a shape or a wall; negative inside."""
    shapes = obstacles.radii.size
    if o >= shapes:
        return wall_distance(obstacles.walls, o - shapes, x, y)
    corners = obstacles.corners[o]
    return distance_and_normal(corners, obstacles.corner_counts[o], obstacles.radii[o], x, y)[0]


@compiled(**INLINE_EXACT)
def _min_distance(obstacles, x, y):
    """Compute the distance of (x, y) to the nearest obstacle or wall, negative inside.

    It is inf if there is none.
    """
    min_distance = math.inf
    for o in range(obstacles.radii.size + obstacles.walls.size):
        min_distance = min(min_distance, _distance(obstacles, o, x, y))
    return min_distance


@compiled(**INLINE_EXACT)
def crosses(obstacles, x0, y0, x1, y1):
    """Check whether a straight segment between two points touches an obstacle or a wall.

    Args:
        obstacles: The obstacles and walls.
        x0: x of the segment's start.
        y0: y of the segment's start.
        x1: x of the segment's end.
        y1: y of the segment's end.
    """
    walls = obstacles.walls
    for w in range(walls.size):
        if wall_distance(walls, w, x0, y0) <= 0 or wall_distance(walls, w, x1, y1) <= 0:
            return True
    for o in range(obstacles.radii.size):
        left, bottom, right, top = box(obstacles, o)
        if max(x0, x1) < left or min(x0, x1) > right:
            continue
        if max(y0, y1) < bottom or min(y0, y1) > top:
            continue
        corners = obstacles.corners[o]
        if touches(corners, obstacles.corner_counts[o], obstacles.radii[o], x0, y0, x1, y1):
            return True
    return False


@compiled(**ENTRY)
def distances_to_obstacles(obstacles, x, y, distances):
    """Compute the distance of each point to each obstacle.

    Args:
        obstacles: The obstacles and walls.
        x: x of the points, shape (P,).
        y: y of the points, shape (P,).
        distances: Filled with the distances, shape (O, P).
    """
    for o in range(distances.shape[0]):
        for n in range(x.size):
            distances[o, n] = _distance(obstacles, o, x[n], y[n])


@compiled(**ENTRY)
def min_pair_distance(x, y):
    """Compute the minimum distance between any two points with coordinates x, y of shape (N,).

    It is inf for a single point.
    """
    min_distance = math.inf
    for i in range(x.size):
        for k in range(i):
            min_distance = min(min_distance, hypot(x[k] - x[i], y[k] - y[i]))
    return min_distance


@compiled(**ENTRY)
def collide(grown, radius, path):
    """Check whether a body touches an obstacle or another body along a path.

    A body that touches an obstacle at the beginning counts only if it goes deeper.

    Args:
        grown: The obstacles, grown by the radius. A body touches one if its centre is inside.
        radius: Radius of a body [length unit].
        path: The path, shape (M, N, 3).
    """
    for i in range(path.shape[1]):
        if _meets_another(i, radius, path) or _enters_obstacle(i, grown, path):
            return True
    return False


@compiled(**INLINE_EXACT)
def _meets_another(i, radius, path):
    """Check whether body i overlaps an earlier body after the first moment of a path.

    It counts only if the two are closer to each other than at the first moment.
    """
    for m in range(1, path.shape[0]):
        for k in range(i):
            initial_distance = hypot(path[0, k, 0] - path[0, i, 0], path[0, k, 1] - path[0, i, 1])
            distance = hypot(path[m, k, 0] - path[m, i, 0], path[m, k, 1] - path[m, i, 1])
            if distance < min(2 * radius, initial_distance):
                return True
    return False


@compiled(**INLINE_EXACT)
def _enters_obstacle(i, grown, path):
    """Check whether the centre of body i enters an obstacle, grown by its radius, along a path.

    A body that begins outside all obstacles enters one by touching it. A body that begins inside
    enters it by going deeper.
    """
    if not _touches_obstacle(i, grown, path):
        return False
    initial_distance = _min_distance(grown, path[0, i, 0], path[0, i, 1])
    begins_clear = initial_distance > 0
    if begins_clear:
        return True
    for m in range(1, path.shape[0]):
        if _min_distance(grown, path[m, i, 0], path[m, i, 1]) < initial_distance:
            return True
    return False


@compiled(**INLINE_EXACT)
def _touches_obstacle(i, grown, path):
    """Check whether the centre of body i touches an obstacle along a path.

    The obstacles are grown by the body's radius. Both the given positions and the straight lines
    between them count.
    """
    for m in range(1, path.shape[0]):
        if crosses(grown, path[m - 1, i, 0], path[m - 1, i, 1], path[m, i, 0], path[m, i, 1]):
            return True
    return False
