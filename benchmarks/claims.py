"""Print what the logs of experiments/studies/claims.yaml say about the paper's claims.

    tetractl study experiments/studies/claims.yaml      some half an hour of a processor
    python benchmarks/claims.py                         the tables, from logs/claims
    python benchmarks/claims.py --figure claims.svg

Section I of the paper: Feedback Ensemble Control needs a rotating field, a large space, and leaves
large errors. So for each trial: the error a robot; the area of the box round all paths, in that of
the box round all starts and targets; the time until the robots stop; the time during which the
field turns in one sense through a whole turn or more; and how fast it turns while it is on.
Everything is simulated.
"""

import argparse
import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from solverbench.report import progress

import tetractl
from tetractl.core.poses import Floats
from tetractl.results.estimate import distributions, proportion_interval

CONTROLLERS = {
    "pso-mpc": "PSO-MPC, as published",
    "ensemble": "Feedback Ensemble Control",
    "recommended": "recommended",
}


REVERSAL = 0.3
"""A field that turns back by up to this angle [rad] has not changed its sense."""


@dataclass(frozen=True)
class Measured:
    """One trial."""

    error: float  # a robot [length unit]
    space: float  # of the paths, in the box of starts and targets
    seconds: float
    spinning_s: float
    turning_rad_s: float
    left: bool


def measure(path: Path) -> Measured:
    """Return what is measured of the trial of a log."""
    log = tetractl.read_log(path)
    assert log.result is not None, "a study's trial has a result"
    arrays, setup = tetractl.to_arrays(log), log.start.setup
    ends = np.concatenate([arrays.truth[0, :, :2], setup.targets])
    spinning_s, rate = turning(arrays.direction, arrays.step_time_s)
    return Measured(
        error=log.result.total_error / len(setup.names),
        space=_box(arrays.truth[:, :, :2].reshape(-1, 2)) / _box(ends),
        seconds=log.result.duration_s,
        spinning_s=spinning_s,
        turning_rad_s=rate,
        left=log.result.left_arena,
    )


def _box(points: Floats) -> float:
    """Return the area of the box round points (M, 2)."""
    return float(np.prod(np.ptp(points, axis=0)))


def turning(direction: Floats, time_s: Floats) -> tuple[float, float]:
    """Return how long a field spins [s], and how fast it turns while it is on [rad/s].

    Directions (K,) are NaN while the field is off. A field spins while it turns in one sense, apart
    from reversals up to REVERSAL, through a whole turn or more.
    """
    turned = np.remainder(np.diff(direction) + np.pi, 2 * np.pi) - np.pi
    took = np.diff(time_s)
    on = np.isfinite(turned)
    rate = float(np.abs(turned[on]).sum() / took[on].sum()) if on.any() else 0.0
    bounds = np.flatnonzero(np.diff(np.concatenate([[False], on, [False]]).astype(int)))
    spinning = sum(
        _spinning(np.concatenate([[0.0], np.cumsum(turned[begin:end])]), time_s[begin : end + 1])
        for begin, end in bounds.reshape(-1, 2)
    )
    return spinning, rate


def _spinning(angle: Floats, time_s: Floats) -> float:
    """Return how long a field spins [s] whose angle [rad], (K,), counts whole turns."""
    spinning, begin, far, sense = 0.0, 0, 0, 0.0
    for k in range(1, len(angle) + 1):
        ahead = sense * (angle[k] - angle[far]) if k < len(angle) else -np.inf
        if ahead < -REVERSAL:  # the sense changed at `far`
            if abs(angle[far] - angle[begin]) >= 2 * np.pi:
                spinning += float(time_s[far] - time_s[begin])
            begin, far, sense = far, k, -sense
        elif ahead >= 0:
            sense = sense or float(np.sign(angle[k] - angle[begin]))
            far = k
    return spinning


def arms(folder: Path) -> dict[tuple[str, int, str], list[Measured]]:
    """Return the trials by controller, number of robots and arena."""
    found: dict[tuple[str, int, str], list[Measured]] = {}
    with (folder / "trials.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for number, row in enumerate(rows):
        if number % 50 == 0:
            progress(f"{number} of {len(rows)} logs")
        if row["counted"] == "true" and row["path"]:
            robots = sum(key.startswith("error_") and bool(row[key]) for key in row)
            key = row["controller"], robots, row["arena"]
            found.setdefault(key, []).append(measure(folder / row["path"]))
    return found


COLUMNS = (
    ("error", "error a robot [mm]", "{:.1f}"),
    ("space", "space, of starts and targets", "{:.2f}"),
    ("seconds", "time [s]", "{:.1f}"),
    ("spinning_s", "field spins [s]", "{:.1f}"),
    ("turning_rad_s", "field turns [rad/s]", "{:.2f}"),
)


def cell(trials: Sequence[Measured], field: str, form: str) -> str:
    """Return the mean of a field over trials with its 95 % interval."""
    values = np.array([[getattr(one, field) for one in trials]])
    (one,) = distributions(values)
    mean = form.format(one.mean)
    if not one.ci95.known:
        return mean
    return f"{mean} [{form.format(one.ci95.low)}, {form.format(one.ci95.high)}]"


def report(found: dict[tuple[str, int, str], list[Measured]]) -> None:
    """Print the tables in Markdown."""
    names = [title for _, title, _ in COLUMNS]
    print(f"| robots | controller | n | {' | '.join(names)} |\n|{'---|' * (len(names) + 3)}")
    for robots in sorted({robots for _, robots, arena in found if not arena}):
        for controller, title in CONTROLLERS.items():
            trials = found.get((controller, robots, ""))
            if trials:
                cells = [cell(trials, field, form) for field, _, form in COLUMNS]
                print(f"| {robots} | {title} | {len(trials)} | {' | '.join(cells)} |")
    print("\n| arena | controller | left the arena | error a robot [mm] |\n|---|---|---|---|")
    for arena in dict.fromkeys(arena for _, _, arena in found if arena):
        for controller, title in CONTROLLERS.items():
            trials = [t for key, v in found.items() if key[::2] == (controller, arena) for t in v]
            left, n = sum(one.left for one in trials), len(trials)
            interval = proportion_interval(left, n)
            share = f"{left} of {n} [{100 * interval.low:.0f}, {100 * interval.high:.0f} %]"
            print(f"| {_size(arena)} | {title} | {share} | {cell(trials, 'error', '{:.1f}')} |")


def _size(arena: str) -> str:
    sides = json.loads(arena)
    return f"{sides['width']:.0f} x {sides['height']:.0f} mm"


def draw(found: dict[tuple[str, int, str], list[Measured]], path: Path) -> None:
    """Draw error, space, time and spinning over the number of robots."""
    from tetractl.core.colors import PALETTE
    from tetractl.view import style

    with style.styled():
        import matplotlib as mpl

        mpl.rcParams["svg.fonttype"] = "none"
        figure = style.figure(style.PAGE_IN, 4.6)
        panels = figure.subplots(2, 2)
        for axes, (field, title, _) in zip(panels.flat, COLUMNS, strict=False):
            for color, (controller, label) in zip(PALETTE, CONTROLLERS.items(), strict=False):
                counts = sorted(n for name, n, arena in found if name == controller and not arena)
                values = [found[controller, n, ""] for n in counts]
                every = [np.array([[getattr(t, field) for t in trials]]) for trials in values]
                about = [distributions(one)[0] for one in every]
                axes.plot(counts, [a.mean for a in about], "-o", ms=3, color=color, label=label)
                known = [(n, a.ci95) for n, a in zip(counts, about, strict=True) if a.ci95.known]
                axes.vlines(
                    [n for n, _ in known],
                    [interval.low for _, interval in known],
                    [interval.high for _, interval in known],
                    color=color,
                    alpha=0.45,
                    linewidth=2.5,
                )
            axes.set_xlabel("robots")
            axes.set_ylabel(title)
            if field == "error":
                axes.set_yscale("log")
        handles, labels = panels[0, 0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)
        figure.savefig(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path("logs/claims"))
    parser.add_argument("--figure", type=Path, help="over the number of robots (.svg or .png)")
    asked = parser.parse_args()
    found = arms(asked.folder)
    report(found)
    if asked.figure:
        draw(found, asked.figure)


if __name__ == "__main__":
    main()
