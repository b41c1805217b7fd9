"""How robots follow commands of speed v and turning rate w, fitted by least squares: a check of
`tetractl identify` that shares no code with it (NumPy alone), nor its model of noise.

    python benchmarks/independent_fit.py car-poses.csv car-commands.csv

A command acts `dead_time` after it is sent; p and q follow v and w with first-order lags. Over each
window of WINDOW_S the robot

    turns by  turning_gain * integral of q  +  veer * integral of p
    drives    speed_gain * integral of p    along its mean heading

For given dead time and lag both are linear; the pair on a grid with the least sum of squares wins,
of the turns (turning lag, and the dead time of both), then of the ways (speed lag). Intervals are
percentiles of a bootstrap of blocks of BLOCK_S, or of takes that are shorter. The sums of dead time
and lag are better determined than either. Each value is also
fitted to the halves and quarters of the recording: how many of these six lie within the interval,
widened by sqrt(2) and 2 for their length?

Shapes: W windows in B blocks; G pairs of dead time and lag on the grid.
"""

import argparse
import csv
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

WINDOW_S = 0.25
BLOCK_S = 30.0
DEAD_TIMES_S = np.arange(-0.1, 0.4001, 0.01)
LAGS_S = np.arange(0.0, 0.6001, 0.02)
RESAMPLES = 1000
FAR = 6.0
"""How far off a window is that is left out, in robust standard deviations."""
SEED = 1


@dataclass(frozen=True)
class Windows:
    """What was sent and measured over W windows; `sent` (G, W, 2) are integrals of p and q, for
    each pair on the grid; `turn`, `way` and `block` are (W,)."""

    sent: np.ndarray
    turn: np.ndarray
    way: np.ndarray
    block: np.ndarray


def tables(poses: Path, commands: Path) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the poses (M, 4) and the commands (K, 3) of each trial."""
    by_trial: list[dict[str, list[list[float]]]] = []
    for path in (poses, commands):
        rows = defaultdict(list)
        with path.open(newline="") as file:
            for trial, *values in list(csv.reader(file))[1:]:
                rows[trial].append([float(value) for value in values])
        by_trial.append(rows)
    return [(np.array(by_trial[0][trial]), np.array(by_trial[1][trial])) for trial in by_trial[0]]


def integrals(time_s: np.ndarray, sent: np.ndarray, at_s: list[np.ndarray]) -> np.ndarray:
    """Return the integrals over the windows between `at_s` (G_d arrays of W + 1) of what follows
    `sent` (K,), held from each `time_s` on, with each lag: (G_d, G_l, W).

    As lag * p' = sent - p, the integral of p is that of `sent` minus lag * p. Before the first
    command, that one is taken as held for long.
    """
    dt = np.diff(time_s)
    whole = np.concatenate([[0.0], np.cumsum(sent[:-1] * dt)])
    places = []
    for at in at_s:
        index = np.clip(np.searchsorted(time_s, at, "right") - 1, 0, None)
        places.append((index, at - time_s[index]))
    of_lags = []
    for lag_s in LAGS_S:
        followed = np.full(len(sent), sent[0])
        decay = np.exp(-dt / lag_s) if lag_s else np.zeros(len(dt))
        for k, share in enumerate(decay):
            followed[k + 1] = sent[k] + (followed[k] - sent[k]) * share
        of_deads = []
        for index, since in places:
            total = whole[index] + sent[index] * since
            if lag_s:
                faded = np.exp(-np.maximum(since, 0.0) / lag_s)
                total -= lag_s * (sent[index] + (followed[index] - sent[index]) * faded)
            of_deads.append(np.diff(total))
        of_lags.append(of_deads)
    return np.array(of_lags).transpose(1, 0, 2)


def windows(trials: list[tuple[np.ndarray, np.ndarray]]) -> Windows:
    """Cut the recording into windows within which commands were sent."""
    sents, turns, ways, blocks = [], [], [], []
    first_block = 0
    for poses, commands in trials:
        begin = max(poses[0, 0], commands[0, 0])
        end = min(poses[-1, 0], commands[-1, 0] + DEAD_TIMES_S[0])
        edges = np.searchsorted(poses[:, 0], np.arange(begin, end, WINDOW_S))
        edges = np.unique(edges[edges < len(poses)])
        time_s, x, y, _ = poses[edges].T
        heading = np.unwrap(poses[:, 3])[edges]
        turn = np.diff(heading)
        middle = heading[:-1] + turn / 2
        chord = np.diff(x) * np.cos(middle) + np.diff(y) * np.sin(middle)
        lasts = np.diff(time_s)
        kept = (lasts > 0.5 * WINDOW_S) & (lasts < 2 * WINDOW_S)
        at_s = [time_s - dead for dead in DEAD_TIMES_S]
        motions = [integrals(commands[:, 0], sent, at_s)[..., kept] for sent in commands[:, 1:].T]
        sents.append(np.stack(motions, axis=-1).reshape(-1, kept.sum(), 2))
        turns.append(turn[kept])
        ways.append((chord / np.sinc(turn / 2 / np.pi))[kept])  # of the arc
        blocks.append(first_block + ((time_s[:-1] - time_s[0]) // BLOCK_S)[kept].astype(int))
        first_block += int((time_s[-1] - time_s[0]) // BLOCK_S) + 1
    return Windows(np.concatenate(sents, axis=1), *map(np.concatenate, (turns, ways, blocks)))


def moments(of: Windows, blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the sums of squares and products of p, q and turn, and of p and way, of each block:
    (B, G, 3, 3) and (B, G, 2, 2)."""
    count = len(of.sent)
    turn = np.broadcast_to(of.turn, (count, len(of.turn)))
    way = np.broadcast_to(of.way, (count, len(of.way)))
    rows = np.dstack([of.sent[..., 0], of.sent[..., 1], turn])
    ways = np.dstack([of.sent[..., 0], way])
    sums = []
    for columns in (rows, ways):
        of_blocks = [columns[:, of.block == block] for block in blocks]
        sums.append(np.array([part.transpose(0, 2, 1) @ part for part in of_blocks]))
    return sums[0], sums[1]


def fit(turns: np.ndarray, ways: np.ndarray) -> dict[str, float]:
    """Return the quantities that sums (G, 3, 3) and (G, 2, 2) over blocks give."""
    normal = turns[:, :2, :2] + 1e-12 * np.eye(2)
    gains = np.linalg.solve(normal, turns[:, :2, 2:])[..., 0]
    left = turns[:, 2, 2] - (gains * turns[:, :2, 2]).sum(1)
    best = int(np.argmin(left))
    dead, lag = divmod(best, len(LAGS_S))
    of_dead = slice(dead * len(LAGS_S), (dead + 1) * len(LAGS_S))
    speed = ways[of_dead, 0, 1] / ways[of_dead, 0, 0]
    way = int(np.argmin(ways[of_dead, 1, 1] - speed * ways[of_dead, 0, 1]))
    return {
        "dead time [s]": DEAD_TIMES_S[dead],
        "turning lag [s]": LAGS_S[lag],
        "speed lag [s]": LAGS_S[way],
        "dead + turning": DEAD_TIMES_S[dead] + LAGS_S[lag],
        "dead + speed": DEAD_TIMES_S[dead] + LAGS_S[way],
        "turning gain": gains[best, 1],
        "speed gain": speed[way],
        "veer [rad/m]": gains[best, 0],
        "turns explained": 1 - left[best] / turns[best, 2, 2],
    }


def without_far(of: Windows) -> Windows:
    """Return the windows without those that are far off at the best fit."""
    sums = moments(of, np.unique(of.block))
    values = fit(sums[0].sum(0), sums[1].sum(0))
    dead = int(np.argmin(abs(DEAD_TIMES_S - values["dead time [s]"])))
    lag = int(np.argmin(abs(LAGS_S - values["turning lag [s]"])))
    p, q = of.sent[dead * len(LAGS_S) + lag].T
    off = [
        of.turn - values["turning gain"] * q - values["veer [rad/m]"] * p,
        of.way - values["speed gain"] * p,
    ]
    kept = np.ones(len(p), dtype=bool)
    for residual in off:
        centred = abs(residual - np.median(residual))
        kept &= centred < FAR * 1.4826 * np.median(centred) + 1e-9
    return Windows(of.sent[:, kept], of.turn[kept], of.way[kept], of.block[kept])


def main(poses: Path, commands: Path) -> None:
    """Print each quantity with its interval, and how many parts of the recording agree."""
    every = windows(tables(poses, commands))
    used = without_far(every)
    blocks = np.unique(used.block)
    turns, ways = moments(used, blocks)
    whole = fit(turns.sum(0), ways.sum(0))
    rng = np.random.default_rng(SEED)
    drawn = [rng.integers(len(blocks), size=len(blocks)) for _ in range(RESAMPLES)]
    spread = [fit(turns[pick].sum(0), ways[pick].sum(0)) for pick in drawn]
    parts = [part for n in (2, 4) for part in np.array_split(np.arange(len(blocks)), n)]
    of_parts = [fit(turns[part].sum(0), ways[part].sum(0)) for part in parts]
    off = len(every.turn) - len(used.turn)
    print(f"{len(used.turn)} windows of {WINDOW_S} s in {len(blocks)} blocks, {off} left out")
    print(f"{'quantity':16}{'value':>9}   {'95 % interval':>20}   halves and quarters within")
    for name, value in whole.items():
        low, high = np.percentile([values[name] for values in spread], [2.5, 97.5])
        wider = [2**0.5] * 2 + [2.0] * 4
        within = sum(
            value - (value - low) * w - 1e-9 <= values[name] <= value + (high - value) * w + 1e-9
            for values, w in zip(of_parts, wider, strict=True)
        )
        print(f"{name:16}{value:9.3f}   {low:9.3f} to {high:7.3f}   {within} of {len(parts)}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("poses", type=Path)
    parser.add_argument("commands", type=Path)
    chosen = parser.parse_args()
    main(chosen.poses, chosen.commands)
