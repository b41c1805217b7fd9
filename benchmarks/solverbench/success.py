"""Part (a): the fraction of seeds with which step 0 is solved to 1 mm, and the time needed."""

from collections.abc import Sequence

import numpy as np

from . import peers, shooting
from .peers import GOOD, Peer, available
from .problems import LENGTH, printed, recommended
from .report import Report, Settings, load, progress


def _optimisers(cap_s: float) -> tuple[list[tuple[str, Peer]], list[str]]:
    """Return the optimisers that take part, and those that are not installed."""
    rows = [
        ("**ours (multistart)**", peers.ours),
        ("our compiled PSO, restarted", peers.our_pso),
        ("our NumPy reference", peers.reference),
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


def _row(name: str, times: Sequence[float], best: Sequence[float]) -> list[str]:
    """Format the fraction solved, and the median and largest time. A timeout counts as its time."""
    solved = np.array(best) <= GOOD
    t = np.array(times) * 1e3
    return [
        name,
        f"{solved.sum()} of {len(solved)}",
        f"{np.median(t):.2f}" if solved.mean() > 0.5 else f"> {np.median(t):.0f}",
        f"{t.max():.1f}",
    ]


HEAD = ["optimiser", "solved", "median [ms]", "longest [ms]"]


def _is_named(who: str, names: Sequence[str]) -> bool:
    return any(name in who for name in names)


def step_0(settings: Settings, only: Sequence[str] = ()) -> Report:
    """Run every optimiser, or those with such names, on the printed and the recommended problem."""
    report = Report("(a) Step 0 solved to a total error of 1 mm")
    everybody, missing = _optimisers(settings.cap_s)
    if only:
        everybody = [(who, peer) for who, peer in everybody if _is_named(who, only)]
    if missing:
        report.say(f"Not installed, skipped: {', '.join(missing)}.")
    report.say(
        f"A search ends at J <= {GOOD:g} mm or after {settings.cap_s:g} s; times are processor "
        f"times. All but IPOPT and the NumPy reference evaluate J by our compiled kernel. "
        f"{load()}."
    )
    for problem, name in ((printed(), "as printed"), (recommended(), "as recommended")):
        rows = []
        peers.compile_for(problem, LENGTH)
        for who, peer in everybody:
            progress(f"(a) {LENGTH} signals, {name}: {who}")
            if "reference" in who and name != "as printed":
                continue
            count = settings.seeds
            if name != "as printed" and "ours" not in who:
                count = settings.peer_seeds
            peers.race(peer, problem, LENGTH, settings.seeds, settings.cap_s)  # warm up
            runs = [
                peers.race(peer, problem, LENGTH, seed, settings.cap_s) for seed in range(count)
            ]
            times, best = zip(*runs, strict=True)
            rows.append(_row(who, times, best))
        report.say(f"**{LENGTH} signals, problem {name}**")
        report.table(HEAD, rows)
    return report
