"""Steer two helices by direction and frequency of one rotating field, against the closed form.

    python benchmarks/helices.py               20 goals, some seconds
    python benchmarks/helices.py --goals 100

The helices of Amoudruz and Koumoutsakos (arXiv 2101.10628) have step-outs of 69.8 and 28.6 rad/s;
k is assumed to be 1 um per radian for both. Goals are drawn with a deviation of 300 um in x and y.
Every 0.1 s the legs of `tetractl.model.rollers` are planned again from the measured positions, and
the first is held for 0.1 s or to its end, until both are within 5 um, undisturbed 1 nm, of their
goals. The closed form, the least time of any plan to the goals, is that of the true values. Prints
Markdown, with 95 % intervals of means.
"""

import argparse
import math

import numpy as np
from scipy import stats

from tetractl.core.errors import UsageError
from tetractl.model.rollers import RollerLeg, Rollers

PERIOD_S, LIMIT_S = 0.1, 300.0
NAMES, K, STEP_OUT = ("one", "two"), np.array([1.0, 1.0]), np.array([69.8, 28.6])
KNOWN = Rollers(NAMES, K, STEP_OUT)
# accepted distance and deviation of positions [um]; greatest relative errors of k and step-out;
# wander [um/sqrt(s)]; the frequencies sent, over the step-outs
WORLDS = {
    "undisturbed": (1e-3, 0.0, 0.0, 0.0, 0.0, 1.0),
    "disturbed (assumed)": (5.0, 1.0, 0.05, 0.02, 1.0, 1.0),
    "disturbed, at 95 % of the step-outs": (5.0, 1.0, 0.05, 0.02, 1.0, 0.95),
}


def drive(goals, rng, world):
    """Return time over the least time, the greatest distance to a goal [um], and whether late."""
    accept, noise, of_k, of_step_out, wander, share = world
    true = Rollers(
        NAMES,
        K * (1 + of_k * rng.uniform(-1, 1, 2)),
        STEP_OUT * (1 + of_step_out * rng.uniform(-1, 1, 2)),
    )
    known = Rollers(NAMES, K, share * STEP_OUT)
    at, seconds = np.zeros((2, 2)), 0.0
    while seconds < LIMIT_S:
        gap = goals - (at + noise * rng.standard_normal((2, 2)))
        if np.hypot(*gap.T).max() < accept:
            break
        leg = known.plan(gap)[0]
        held_s = min(PERIOD_S, leg.seconds)
        at = at + true.moved(RollerLeg(leg.direction, leg.frequency, held_s))
        at = at + wander * math.sqrt(held_s) * rng.standard_normal((2, 2))
        seconds += held_s
    least = sum(leg.seconds for leg in true.plan(goals))
    return seconds / least, np.hypot(*(goals - at).T).max(), seconds >= LIMIT_S


def along_axes(goals):
    """Return the time of the closed form as published, over that along free directions."""
    legs = np.array([[np.cos(u), np.sin(u)] for u, _, _ in KNOWN.plan(goals)])
    legs *= np.array([leg.seconds for leg in KNOWN.plan(goals)])[:, None]
    turn = np.linspace(0, np.pi / 2, 1001)
    axes = np.stack([np.cos(turn), np.sin(turn)]), np.stack([-np.sin(turn), np.cos(turn)])
    times = sum(np.abs(legs @ axis).sum(axis=0) for axis in axes)
    return times.min() / np.hypot(*legs.T).sum()


def main(count, seed):
    """Print the table."""
    rng = np.random.default_rng(seed)
    goals = rng.normal(0, 300, (count, 2, 2))
    print(
        "| world | n | time / closed form, mean | worst | furthest from its goal | at the limit |"
    )
    print("|---|---|---|---|---|---|")
    for name, world in WORLDS.items():
        found = np.array([drive(one, rng, world) for one in goals])
        ratio, far, late = found.T
        half = stats.t.ppf(0.975, count - 1) * ratio.std(ddof=1) / math.sqrt(count)
        mean = ratio.mean()
        print(
            f"| {name} | {count} | {mean:.3f} [{mean - half:.3f}, {mean + half:.3f}] | "
            f"{ratio.max():.3f} | {far.max():.2g} um | {late.sum():.0f} |"
        )
    published = np.array([along_axes(one) for one in goals])
    print(f"\nPublished closed form, along two axes: {published.mean():.3f} times the least time.")
    try:
        Rollers(NAMES, K, np.array([28.6, 28.6])).plan(goals[0])
    except UsageError as error:
        print(f"\nEqual step-outs: {error.message}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--goals", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    main(given.goals, given.seed)
