"""The smallest disc in which one robot that never stops can be for 95 % of the time, numerically.

    python benchmarks/least_disc.py                  the bacterium of reproduce, some minutes

Nothing is shared with the controller or the plant. The robot drives at v and turns by (3); its
heading wanders by W rad/sqrt(s); every period a direction is chosen with its pose, a and v known
exactly. Lengths are in v / a, times in 1 / a. Of the target in the robot's view, polar (r, phi),
value iteration finds the policy with the greatest share of the time within R, on a grid with
interpolation, of which the error is seen by two grids; the policy is then run without a grid for
holds of 35 s. Prints Markdown.
"""

import argparse
import math

import numpy as np

ACTIONS = np.linspace(-math.pi, math.pi, 48, endpoint=False)
PARTS = 8
BEYOND = 2.5
KEPT = 0.998
HOLD_S = 35.0
SHARE = 0.95


def moved(x, y, period):
    """Return the targets (PARTS, A, ...) in the view of a robot after parts of a period, one for
    each action, for targets x, y (...); lengths in v / a, times in 1 / a."""
    u = ACTIONS.reshape(-1, *[1] * np.ndim(x))
    heading = 0.0 * u
    at_x = 0.0 * u
    at_y = 0.0 * u
    moves = []
    fine = 4
    dt = period / PARTS / fine
    for _ in range(PARTS):
        for _ in range(fine):
            half = heading + dt / 2 * np.sin(u - heading)
            at_x = at_x + dt * np.cos(half)
            at_y = at_y + dt * np.sin(half)
            heading = heading + dt * np.sin(u - half)
        gap_x = x - at_x
        gap_y = y - at_y
        c = np.cos(heading)
        s = np.sin(heading)
        moves.append((c * gap_x + s * gap_y, c * gap_y - s * gap_x))
    return moves


class Policy:
    """The value of every state for a disc of radius R, and the choice by it."""

    def __init__(self, radius, period, sigma, steps):
        self.period = period
        self.radius = radius
        self.step = BEYOND / steps
        self.rows = steps + 1
        self.columns = 3 * steps // 2
        r = np.arange(self.rows) * self.step
        phi = np.arange(self.columns) * math.tau / self.columns
        x = r[:, None] * np.cos(phi)
        y = r[:, None] * np.sin(phi)
        places = moved(x, y, period)
        within = [(np.hypot(*place) <= radius + 1e-9).astype(np.float32) for place in places]
        reward = (1 - KEPT) * np.mean(within, axis=0)
        index, weight = self.corners(*places[-1])
        wave = np.exp(-((sigma * np.arange(self.columns // 2 + 1)) ** 2) / 2)
        self.value = np.zeros(self.rows * self.columns)
        for _ in range(60):
            blurred = self.blur(self.value, wave)
            best = (reward + KEPT * self.at(blurred, index, weight)).argmax(axis=0)[None]
            own_reward = np.take_along_axis(reward, best, 0)[0]
            i, w = (np.take_along_axis(table, best[None], 1)[:, 0] for table in (index, weight))
            before = self.value
            for _ in range(60):
                self.value = (
                    own_reward + KEPT * self.at(self.blur(self.value, wave), i, w)
                ).ravel()
            if np.abs(self.value - before).max() < 1e-4:
                break
        self.value = self.blur(self.value, wave)

    def blur(self, value, wave):
        """Return the mean of a value over the heading's noise."""
        rows = np.fft.rfft(value.reshape(self.rows, self.columns), axis=1)
        return np.fft.irfft(rows * wave, n=self.columns, axis=1).ravel()

    def corners(self, x, y):
        """Return indices and weights (4, ...) of the grid's points around points (...)."""
        i = np.minimum(np.hypot(x, y) / self.step, self.rows - 1.001)
        j = np.arctan2(y, x) % math.tau / math.tau * self.columns
        row = i.astype(np.int32)
        column = j.astype(np.int32)
        i = (i - row).astype(np.float32)
        j = (j - column).astype(np.float32)
        first_column = column % self.columns
        right = (column + 1) % self.columns
        low = row * self.columns
        high = (row + 1) * self.columns
        index = np.stack([low + first_column, low + right, high + first_column, high + right])
        return index, np.stack([(1 - i) * (1 - j), (1 - i) * j, i * (1 - j), i * j])

    def at(self, value, index, weight):
        """Return a value (...) between the grid's points."""
        return sum(w * value[i] for i, w in zip(index, weight, strict=True))

    def holds(self, trials, steps, sigma, rng):
        """Return the distances (steps PARTS, trials) from the target while it is held."""
        x = np.zeros(trials)
        y = np.full(trials, self.radius)
        places = []
        for k in range(steps + 40):
            places_after = np.array(moved(x, y, self.period))
            index, weight = self.corners(*places_after[-1])
            within = (np.hypot(places_after[:, 0], places_after[:, 1]) <= self.radius).mean(axis=0)
            value = (1 - KEPT) * within + KEPT * self.at(self.value, index, weight)
            path = places_after[:, :, value.argmax(axis=0), np.arange(trials)]
            turn = sigma * rng.standard_normal(trials)
            x, y = path[-1]
            cosine = np.cos(turn)
            sine = np.sin(turn)
            turned_x = cosine * x + sine * y
            y = cosine * y - sine * x
            x = turned_x
            if k >= 40:
                places.append(np.hypot(path[:, 0], path[:, 1]))
        return np.concatenate(places)


def main(a, speed, noise, period_s, trials, seed):
    """Print the table."""
    sigma = noise * math.sqrt(period_s)
    floor = 2 * speed / a
    print(
        f"2 v / a = {floor:.1f} um; heading noise {noise:g} rad/sqrt(s), control {period_s:g} s\n"
    )
    print("| R a / v | grid | share within R | diameter of the disc of 95 % | over 2 v / a |")
    print("|---|---|---|---|---|")
    for radius in (1.08, 1.11, 1.13, 1.15):
        for steps in (60, 100):
            policy = Policy(radius, a * period_s, sigma, steps)
            rng = np.random.default_rng(seed)
            gaps = policy.holds(trials, round(HOLD_S / period_s), sigma, rng)
            disc = np.quantile(gaps, SHARE, axis=0)
            half = 1.96 * disc.std(ddof=1) / math.sqrt(trials)
            share = (gaps <= radius).mean()
            print(
                f"| {radius:g} | {steps} | {share:.3f} | {floor * disc.mean():.1f} um | "
                f"{disc.mean():.3f} [{disc.mean() - half:.3f}, {disc.mean() + half:.3f}] |",
                flush=True,
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--a", type=float, default=2.2)
    parser.add_argument("--speed", type=float, default=32.0)
    parser.add_argument("--noise", type=float, default=0.1)
    parser.add_argument("--period", type=float, default=0.1)
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    main(options.a, options.speed, options.noise, options.period, options.trials, options.seed)
