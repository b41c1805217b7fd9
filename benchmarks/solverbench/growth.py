"""(d) how the time of an iteration grows with particles, horizon and robots, with a plot."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from tetractl.core.colors import BLUE, GREEN, RED
from tetractl.core.plan import Limits, Problem
from tetractl.view.style import GREY, figure, panel, save, styled

from .problems import PARTICLES, SIGNALS, SWARM, printed, random_robots
from .report import Report, Settings, least, load, progress

Case = Callable[[int], tuple[Problem, int, int]]
"""From a size to (problem, particles, signals)."""


def growth(settings: Settings, plot: Path | None) -> Report:
    """Fit an exponent to each, and draw them."""
    report = Report("(d) Growth")
    problem = printed()
    step = 4 if settings.quick else 1
    series: list[tuple[str, Sequence[int], Case, str]] = [
        (
            "particles",
            [32, 64, 128, 256, 512, 1024, 2048, 4096][::step],
            lambda n: (problem, n, SIGNALS),
            GREEN,
        ),
        (
            "signals",
            [10, 20, 41, 60, 80, 100, 150, 200][::step],
            lambda n: (problem, PARTICLES, n),
            BLUE,
        ),
        (
            "robots",
            [1, 2, 3, 4, 8, 16, 32, 64][::step],
            lambda n: (random_robots(n), PARTICLES, SIGNALS),
            RED,
        ),
    ]
    rows = []
    drawn = []
    for name, sizes, case, color in series:
        progress(f"(d) growth with {name}")
        times = np.array([_iteration(*case(size), settings) for size in sizes])
        exponent, _ = np.polyfit(np.log(sizes), np.log(times), 1)
        tail = float(np.log(times[-1] / times[-2]) / np.log(sizes[-1] / sizes[-2]))
        listed = ", ".join(f"{n}: {t:.1f}" for n, t in zip(sizes, times, strict=True))
        rows.append([name, listed, f"{exponent:.3f}", f"{tail:.2f}"])
        drawn.append((name, np.array(sizes), times, exponent, color))
    report.say(
        f"Compiled swarm, Euler, one obstacle, one thread; of {PARTICLES} particles, {SIGNALS} "
        f"signals and 3 robots one at a time is varied. Least processor time of several searches; "
        f"the exponent is that of the best power law through all sizes, fixed cost included, and "
        f"the last column that of the last two sizes alone. {load()}."
    )
    report.table(["size", "us per iteration", "exponent", "of the last two"], rows)
    if plot is not None:
        _draw(drawn, plot)
        report.say(f"![Time of an iteration against its size]({plot.name})")
    return report


def _iteration(problem: Problem, particles: int, signals: int, settings: Settings) -> float:
    """Time of one iteration [us]."""
    iterations = max(4, min(100, 400_000 // (particles * signals)))
    spec = SWARM.model_copy(update={"particles": particles, "iterations": iterations})
    none = spec.model_copy(update={"iterations": 1})
    search = lambda chosen: chosen.search(problem, signals, None, 1, Limits())  # noqa: E731
    search_s = least(lambda: search(spec), settings.repeats)
    start = least(lambda: search(none), settings.repeats)
    return (search_s - start) / (iterations - 1) * 1e6


def _draw(series: Sequence[tuple], path: Path) -> None:
    with styled():
        drawing = figure(7.16, 2.3)
        panels = drawing.subplots(1, 3, sharey=True)
        for axes, letter, (name, sizes, times, exponent, color) in zip(
            panels, "abc", series, strict=True
        ):
            line = times[0] * sizes / sizes[0]
            axes.loglog(sizes, line, color=GREY, lw=0.8, ls=(0, (4, 3)), label="proportional")
            axes.loglog(sizes, times, "o-", color=color, ms=3, label=f"exponent {exponent:.2f}")
            axes.set_xlabel(name)
            axes.set_xticks(sizes[:: 2 if len(sizes) > 5 else 1], minor=False)
            axes.set_xticks([], minor=True)
            axes.set_xticklabels([str(n) for n in sizes[:: 2 if len(sizes) > 5 else 1]])
            axes.legend(loc="upper left")
            panel(axes, letter, f"growth with {name}")
        panels[0].set_ylabel("time of one iteration [µs]")
        save(drawing, path)
