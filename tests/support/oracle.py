"""The paper once more, one number at a time: slow, without arrays, from the equations alone.

Nothing here comes from tetractl.control. Draw i of a key is SplitMix64's; which draw goes where is
the layout that both implementations promise: coordinate j of particle n is number j * np + n.
"""

import math
from dataclasses import dataclass, field

from support.geometry import gap, meets

LOWER, UPPER = -math.pi, math.pi
SPAN = UPPER - LOWER
MASK = 2**64 - 1


@dataclass
class World:
    """Robots are (x, y, heading, target x, target y, a, speed); lengths as they come."""

    robots: list[tuple[float, ...]]
    obstacles: list
    model: str = "euler"
    period: float = 0.2
    weight: float = 1000.0
    swept: bool = False


def step(model, x, y, theta, u, a, v, t):
    turn = a * math.sin(u - theta)
    if model == "euler":
        return x + t * v * math.cos(theta), y + t * v * math.sin(theta), theta + t * turn
    if model == "arc":
        if abs(turn * t) < 1e-8:
            return x + t * v * math.cos(theta), y + t * v * math.sin(theta), theta + t * turn
        end, radius = theta + turn * t, v / turn
        x += radius * (math.sin(end) - math.sin(theta))
        return x, y - radius * (math.cos(end) - math.cos(theta)), end
    phi, e = u - theta, math.exp(-a * t)
    c, s = math.cos(phi), math.sin(phi)
    turned = 2 * math.atan2(s * (1 - e), (1 + c) + (1 - c) * e)
    along = v * (t + math.log(((1 + c) + (1 - c) * e * e) / 2) / a)
    right = v * turned / a
    x += along * math.cos(u) + right * math.sin(u)
    return x, y + along * math.sin(u) - right * math.cos(u), theta + turned


def cost(world: World, signals) -> float:
    """(7)-(13) of one sequence."""
    f = potential = 0.0
    for x, y, theta, target_x, target_y, a, v in world.robots:
        for u in signals:
            before = x, y
            x, y, theta = step(world.model, x, y, theta, u, a, v, world.period)
            if world.swept:
                hit = any(meets(thing, *before, x, y) for thing in world.obstacles)
            else:
                hit = any(gap(thing, x, y) <= 0 for thing in world.obstacles)
            potential += 1.0 if hit else 0.0  # (13), summed as in (9)
        f += math.hypot(x - target_x, y - target_y)  # (8)
    return f + world.weight * potential  # (7)


def split_mix(key: int, index: int) -> int:
    z = (key + (index + 1) * 0x9E3779B97F4A7C15) & MASK
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return z ^ (z >> 31)


@dataclass
class Swarm:
    """Algorithm 1 as it goes: `history[z]` is J(u_gb) after iteration z."""

    world: World
    u: list[list[float]]
    v: list[list[float]]
    best: list[list[float]]
    u_gb: list[float]
    history: list[float] = field(default_factory=list)


def search(world: World, length: int, warm, spec, key: int, iterations: int) -> Swarm:
    """Algorithm 1 for a number of iterations, without any stop."""
    n_p = spec.particles

    def scattered(which):
        rows = [[0.0] * length for _ in range(n_p)]
        for j in range(length):
            for n in range(n_p):
                index = (which * length + j) * n_p + n
                rows[n][j] = (split_mix(split_mix(key, 0), index) >> 11) / 2**53
        return rows

    u, v, best = scattered(0), scattered(1), scattered(2)  # line 1
    for n in range(n_p):
        for j in range(length):
            u[n][j] = LOWER + SPAN * u[n][j]
            v[n][j] = -SPAN + 2 * SPAN * v[n][j]
            best[n][j] = LOWER + SPAN * best[n][j]
    u_gb = list(min(best, key=lambda b: cost(world, b)))  # lines 2-3
    if warm is not None:
        u_gb = list(warm)  # line 5
    swarm = Swarm(world, u, v, best, u_gb, [cost(world, u_gb)])
    for z in range(iterations):
        for n in range(n_p):
            for j in range(length):
                bits = split_mix(split_mix(key, 1), (z * length + j) * n_p + n)
                r1, r2 = (bits >> 33) / 2**31, (bits & 0x7FFFFFFF) / 2**31
                new = (
                    spec.inertia * v[n][j]
                    + spec.cognitive * r1 * (best[n][j] - u[n][j])
                    + spec.social * r2 * (swarm.u_gb[j] - u[n][j])
                )  # (14)
                v[n][j] = max(-SPAN, min(new, SPAN))  # (15)
                u[n][j] = max(LOWER, min(u[n][j] + v[n][j], UPPER))  # (16)-(17)
        for n in range(n_p):
            if cost(world, u[n]) < cost(world, best[n]):
                best[n] = list(u[n])  # (18)
        leader = min(best, key=lambda b: cost(world, b))
        if cost(world, leader) < cost(world, swarm.u_gb):
            swarm.u_gb = list(leader)  # (19)
        swarm.history.append(cost(world, swarm.u_gb))
    return swarm
