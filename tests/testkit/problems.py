"""Random control problems in general position: no robot ever just touches an edge."""

import numpy as np

from testkit.references.paper import World
from tetractl.control.search.cost import evaluate
from tetractl.control.search.optimizers.pso import Pso, find_best
from tetractl.core.obstacles import Obstacles
from tetractl.core.plan import Problem
from tetractl.core.poses import Poses
from tetractl.model.shapes import Circle, Polygon, Rectangle

HOOK = np.array([(0, 0), (3, 0), (3, 2), (2.4, 2), (2.4, 0.6), (0, 0.6)])


def world(
    seed: int,
    robots: int = 3,
    obstacles: int = 2,
    model: str = "euler",
    swept: bool = False,
    period: float = 0.2,
) -> World:
    """Robots and overlapping obstacles of the size of the paper's experiment, in mm."""
    rng = np.random.default_rng(seed)
    things = []
    for i in range(obstacles):
        x, y = rng.uniform(100, 700, 2)
        if i % 3 == 1:
            things.append(Circle(type="circle", center=(x, y), radius=rng.uniform(20, 200)))
        elif i % 3 == 2:
            turn = rng.uniform(-4, 4)
            c = np.cos(turn)
            s = np.sin(turn)
            vertices = rng.uniform(30, 100) * HOOK @ np.array([[c, s], [-s, c]]) + (x, y)
            corners = [tuple(vertex) for vertex in vertices]
            things.append(Polygon(type="polygon", vertices=tuple(corners)))
        else:
            width, height = rng.uniform(20, 300, 2)
            box = Rectangle(type="rectangle", left=x, bottom=y, width=width, height=height)
            things.append(box)
    rows = [random_robot(rng) for _ in range(robots)]
    return World(rows, things, model, period, float(rng.uniform(10, 2000)), swept)


def random_robot(rng: np.random.Generator) -> tuple[float, ...]:
    """A robot as the oracle takes it: x, y, heading, target x, target y, a, speed."""
    start = rng.uniform(0, 800, 2)
    heading = rng.uniform(-4, 4)
    target = rng.uniform(0, 800, 2)
    a = rng.uniform(1, 7)
    speed = rng.uniform(50, 250)
    return (*start, heading, *target, a, speed)


def problem(world: World, separation: float = 0.0, drifts: bool = False) -> Problem:
    """The same as tetractl takes it; robots that drift have heading biases and a flow."""
    robots = np.array(world.robots)
    rng = np.random.default_rng(len(robots))
    return Problem(
        poses=Poses.from_array(robots[:, :3]),
        targets=robots[:, 3:5],
        a=robots[:, 5],
        speed=robots[:, 6],
        motion=world.model,
        period=world.period,
        first_period=world.period,
        obstacles=Obstacles.from_shapes([thing.shape() for thing in world.obstacles]),
        obstacle_weight=world.weight,
        swept=world.swept,
        separation=separation,
        bias=rng.uniform(-0.3, 0.3, len(robots)) if drifts else None,
        flow=rng.uniform(-20, 20, (len(robots), 2)) if drifts else None,
    )


def is_decided(problem: Problem, length: int, warm, spec: Pso, key: int) -> bool:
    """Whether no comparison in a search is so close that rounding may decide it.

    Directions of exactly pi and -pi, where (17) clamps many a particle, are the same direction.
    """

    def close(cost, other_cost, u, other_u):
        near = np.abs(cost - other_cost) <= 1e-9 * (1 + np.abs(cost))
        return bool(np.any(near & (u != other_u).any(axis=-1)))

    swarm = spec.create_swarm(problem, length, warm, key)
    for _ in range(spec.iterations):
        global_best = swarm.global_best
        local_bests = swarm.u_lb.T.copy()
        local_costs = swarm.local_best_costs.copy()
        swarm.iterate()
        if close(evaluate(problem, swarm.u.T).total, local_costs, swarm.u.T, local_bests):
            return False
        leader = find_best(swarm.u_lb, swarm.local_best_costs)
        if close(swarm.local_best_costs, leader.cost, swarm.u_lb.T, leader.signals):
            return False
        if close(leader.cost, global_best.cost, leader.signals, global_best.signals):
            return False
    return True
