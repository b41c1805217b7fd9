"""Part (a): the fraction of seeds with which step 0 is solved to 1 mm, and the time needed."""

from collections.abc import Sequence

import numpy as np

from . import peers, shooting
from .peers import GOOD_COST_MM, Peer, available
from .problems import LENGTH, printed, recommended
from .report import Report, Settings, describe_load, print_progress


def _list_optimisers(cap_s: float) -> tuple[list[tuple[str, Peer]], list[str]]:
    """List the optimisers that take part, and the names of those that are not installed."""
    rows = [
        ("**ours (multistart)**", peers.ours),
        ("our compiled PSO, restarted", peers.our_pso),
        ("our NumPy reference", peers.numpy_reference),
        ("scipy differential evolution", peers.scipy_de),
    ]
    missing = []
    for module, name, peer in (
        ("pyswarms", "pyswarms", peers.pyswarms),
        ("cma", "pycma", peers.pycma),
        (shooting.PACKAGE, "CasADi + IPOPT", shooting.ipopt(cap_s)),
    ):
        if available(module):
            rows.append((name, peer))
        else:
            missing.append(module)
    return rows, missing


def _format_row(name: str, times_s: Sequence[float], best_costs: Sequence[float]) -> list[str]:
    """Format a row of the table: how many runs were solved, and the median and longest time.

    A run that timed out counts with the time that it took.
    """
    solved = np.array(best_costs) <= GOOD_COST_MM
    times_ms = np.array(times_s) * 1e3
    return [
        name,
        f"{solved.sum()} of {len(solved)}",
        f"{np.median(times_ms):.2f}" if solved.mean() > 0.5 else f"> {np.median(times_ms):.0f}",
        f"{times_ms.max():.1f}",
    ]


TABLE_HEAD = ["optimiser", "solved", "median [ms]", "longest [ms]"]


def _is_named(optimiser: str, names: Sequence[str]) -> bool:
    return any(name in optimiser for name in names)


def step_0(settings: Settings, names: Sequence[str] = ()) -> Report:
    """Run optimisers on step 0 of the printed and of the recommended problem.

    Args:
        settings: Numbers of seeds, and the time limit of a search.
        names: Parts of the names of the optimisers to run. By default, all of them run.
    """
    report = Report("(a) Step 0 solved to a total error of 1 mm")
    optimisers, missing = _list_optimisers(settings.cap_s)
    if names:
        optimisers = [
            (optimiser, peer) for optimiser, peer in optimisers if _is_named(optimiser, names)
        ]
    if missing:
        report.say(f"Not installed, skipped: {', '.join(missing)}.")
    report.say(
        f"A search ends at J <= {GOOD_COST_MM:g} mm or after {settings.cap_s:g} s; times are "
        f"processor times. All but IPOPT and the NumPy reference evaluate J by our "
        f"compiled kernel. {describe_load()}."
    )
    for problem, problem_name in ((printed(), "as printed"), (recommended(), "as recommended")):
        rows = []
        peers.compile_for(problem, LENGTH)
        for optimiser, peer in optimisers:
            print_progress(f"(a) {LENGTH} signals, {problem_name}: {optimiser}")
            if "reference" in optimiser and problem_name != "as printed":
                continue
            count = settings.seeds
            if problem_name != "as printed" and "ours" not in optimiser:
                count = settings.peer_seeds
            peers.race(peer, problem, LENGTH, settings.seeds, settings.cap_s)  # warm up
            runs = [
                peers.race(peer, problem, LENGTH, seed, settings.cap_s) for seed in range(count)
            ]
            times_s, best_costs = zip(*runs, strict=True)
            rows.append(_format_row(optimiser, times_s, best_costs))
        report.say(f"**{LENGTH} signals, problem {problem_name}**")
        report.table(TABLE_HEAD, rows)
    return report
