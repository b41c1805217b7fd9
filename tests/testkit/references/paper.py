"""The paper implemented once more: slow, without arrays, only from the equations.

Nothing here comes from tetractl.control. Random number i of a key is the one of SplitMix64. Both
implementations use the same order: coordinate j of particle n is number j * np + n.
"""

import math
from dataclasses import dataclass, field

from testkit.geometry import gap, meets

LOWER = -math.pi
UPPER = math.pi
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
    phi = u - theta
    e = math.exp(-a * t)
    c = math.cos(phi)
    s = math.sin(phi)
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


def scattered(key: int, which: int, particles: int, length: int) -> list[list[float]]:
    """Return uniform numbers in [0, 1), a row a particle: the `which`-th block of such draws."""
    rows = [[0.0] * length for _ in range(particles)]
    for j in range(length):
        for n in range(particles):
            index = (which * length + j) * particles + n
            rows[n][j] = (split_mix(split_mix(key, 0), index) >> 11) / 2**53
    return rows


def start(world: World, length: int, warm, spec, key: int) -> Swarm:
    """Lines 1 to 5 of algorithm 1."""
    n_p = spec.particles
    u = scattered(key, 0, n_p, length)  # line 1
    v = scattered(key, 1, n_p, length)
    best = scattered(key, 2, n_p, length)
    for n in range(n_p):
        for j in range(length):
            u[n][j] = LOWER + SPAN * u[n][j]
            v[n][j] = -SPAN + 2 * SPAN * v[n][j]
            best[n][j] = LOWER + SPAN * best[n][j]
    u_gb = list(min(best, key=lambda b: cost(world, b)))  # lines 2-3
    if warm is not None:
        u_gb = list(warm)  # line 5
    return Swarm(world, u, v, best, u_gb, [cost(world, u_gb)])


def move(swarm: Swarm, spec, key: int, z: int) -> None:
    """(14)-(17) for each number of each particle, in iteration z."""
    length = len(swarm.u_gb)
    for n in range(spec.particles):
        u = swarm.u[n]
        v = swarm.v[n]
        best = swarm.best[n]
        for j in range(length):
            bits = split_mix(split_mix(key, 1), (z * length + j) * spec.particles + n)
            r1 = (bits >> 33) / 2**31
            r2 = (bits & 0x7FFFFFFF) / 2**31
            new = (
                spec.inertia * v[j]
                + spec.cognitive * r1 * (best[j] - u[j])
                + spec.social * r2 * (swarm.u_gb[j] - u[j])
            )  # (14)
            v[j] = max(-SPAN, min(new, SPAN))  # (15)
            u[j] = max(LOWER, min(u[j] + v[j], UPPER))  # (16)-(17)


def search(world: World, length: int, warm, spec, key: int, iterations: int) -> Swarm:
    """Algorithm 1 for a number of iterations, without any stop."""
    swarm = start(world, length, warm, spec, key)
    for z in range(iterations):
        move(swarm, spec, key, z)
        for n in range(spec.particles):
            if cost(world, swarm.u[n]) < cost(world, swarm.best[n]):
                swarm.best[n] = list(swarm.u[n])  # (18)
        leader = min(swarm.best, key=lambda b: cost(world, b))
        if cost(world, leader) < cost(world, swarm.u_gb):
            swarm.u_gb = list(leader)  # (19)
        swarm.history.append(cost(world, swarm.u_gb))
    return swarm
