"""(a) time per PSO iteration at equal particles; (e) time per robot-step against a floor."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numba import njit

from tetractl.control.cost import evaluate
from tetractl.control.kernels.rollout import costs, lay_out
from tetractl.control.optimizers.pso import Swarm
from tetractl.core.plan import Problem
from tetractl.model.motion.polynomials import horner
from tetractl.tools.kernels.kernel_options import ENTRY_FAST, inlined

from .peers import OPTIONS, available
from .problems import PARTICLES, SIGNALS, SWARM, plain_cost, printed, recommended, tuned_cost
from .report import Pair, Report, Settings, in_pairs, load

SHORT = 20
"""Iterations timed at once: few, so that most repetitions run through without an interruption."""
polynomial = inlined(horner)
ROBOT_STEPS = 3 * PARTICLES * SIGNALS
EULER_WORK = 42
"""Vector instructions of one robot-step of (4)-(6), counted in the source: 26 for the motion, 9 for
one rectangle, and a third of the 21 that turn a signal into a direction for three robots."""


def iteration(settings: Settings) -> Report:
    """Ours against pyswarms and the readable reference, in interleaved pairs."""
    report = Report("(a) Time per PSO iteration")
    report.say(
        f"{PARTICLES} particles, {SIGNALS} signals, 3 robots, one obstacle, Euler, one thread; "
        f"ours and the peer timed in turn, {load()}."
    )
    problem = printed()
    count = settings.repeats * 2
    search = _Iterations(problem)
    rows = []

    def add(name: str, peer: Callable[[int], object], bar: tuple[str, float] | None = None) -> None:
        pair = in_pairs(lambda: search.run(SHORT), lambda: peer(2), count)
        pair = Pair(pair.ours / SHORT * 1e6, pair.theirs / 2 * 1e6)
        absolute = [f"{np.min(t):.1f} / {np.median(t):.1f}" for t in (pair.ours, pair.theirs)]
        rows.append([name, *absolute, f"{pair.ratio:.0f}x", f"{pair.median:.0f}x"])
        if bar:
            figure, least = bar
            text = f"{pair.ratio:.0f}x ({absolute[0]} against {absolute[1]} us, least / median)"
            report.bar(figure, f">= {least:g}x less", text, pair.ratio >= least)

    figure = "time per PSO iteration against our NumPy reference"
    add("our swarm, J by our NumPy reference", _reference(problem), (figure, 40))
    if available("pyswarms"):
        figure = "time per PSO iteration against pyswarms"
        add("pyswarms, J in plain NumPy", _pyswarms(plain_cost(problem)), (figure, 80))
        tuned = f"{figure}, J in tuned NumPy"
        add("pyswarms, J in tuned NumPy", _pyswarms(tuned_cost(problem)), (tuned, 80))
        add("pyswarms, J by our kernel", _pyswarms(_by_kernel(problem)))
    else:
        report.say("pyswarms is not installed: skipped.")
    report.table(["peer", "ours [us]", "peer [us]", "ratio of the least", "median of pairs"], rows)
    report.say("Times are least / median. Starting a search is not counted on either side.")
    return report


class _Iterations:
    """Iterations of the compiled swarm, and nothing else."""

    def __init__(self, problem: Problem) -> None:
        self.swarm = SWARM.swarm(problem, SIGNALS, None, key=1)

    def run(self, count: int) -> None:
        for _ in range(count):
            self.swarm.iterate()


def _reference(problem: Problem) -> Callable[[int], None]:
    swarm = Swarm.scattered(SWARM, SIGNALS, 1, lambda signals: evaluate(problem, signals.T).total)

    def run(count: int) -> None:
        for _ in range(count):
            swarm.iterate()

    return run


def _pyswarms(cost: Callable) -> Callable[[int], object]:
    from pyswarms.single import GlobalBestPSO

    bounds = (np.full(SIGNALS, -np.pi), np.full(SIGNALS, np.pi))
    swarm = GlobalBestPSO(PARTICLES, SIGNALS, OPTIONS, bounds, bh_strategy="nearest")
    return lambda count: swarm.optimize(cost, count, verbose=False)


def _by_kernel(problem: Problem) -> Callable:
    course = lay_out(problem, PARTICLES)
    total = np.empty(PARTICLES)

    def cost(signals: np.ndarray) -> np.ndarray:
        costs(course, np.ascontiguousarray(signals.T), total)
        return total.copy()

    return cost


def floor(settings: Settings) -> Report:
    """The rollout kernel against what the processor can do at all."""
    report = Report("(e) Time per robot-step against a floor")
    euler = printed()
    exact = replace(euler, motion="exact")
    rows = np.zeros((11, PARTICLES * 3))
    rng = np.random.default_rng(0)
    signals = rng.uniform(-np.pi, np.pi, (SIGNALS, PARTICLES))
    total = np.empty(PARTICLES)
    course = lay_out(euler, PARTICLES)
    layout = lay_out(exact, PARTICLES)
    q = rng.uniform(0, 0.5, PARTICLES * 3)
    count = settings.repeats * 20
    roll = lambda: costs(course, signals, total)  # noqa: E731
    work = in_pairs(roll, lambda: _arithmetic(q, rows, SIGNALS), count)
    move = in_pairs(roll, lambda: _traffic(rows, SIGNALS), count)
    models = in_pairs(roll, lambda: costs(layout, signals, total), count)
    swept = [lay_out(replace(recommended(), motion=m), PARTICLES) for m in ("euler", "exact")]
    walls = in_pairs(
        lambda: costs(swept[0], signals, total), lambda: costs(swept[1], signals, total), count
    )
    iterations = _Iterations(euler)
    two = _Iterations(exact)
    searches = in_pairs(lambda: iterations.run(SHORT), lambda: two.run(SHORT), settings.repeats * 5)
    ns = 1e9 / ROBOT_STEPS
    table = [
        ["Euler rollout and obstacle, our kernel", np.min(models.ours) * ns, 1.0],
        [
            "exact rollout and obstacle, our kernel",
            np.min(models.theirs) * ns,
            models.ratio,
        ],
        [f"floor: {EULER_WORK} vector instructions", np.min(work.theirs) * ns, work.ratio],
        ["floor: 6 loads and 5 stores in L1", np.min(move.theirs) * ns, move.ratio],
    ]
    report.say(
        f"Reference size, one thread, {load()}. The floor is what this processor, in the same "
        f"process and in turn with the kernel, takes for as many vector instructions as the "
        f"source of one Euler step has ({EULER_WORK}, nearly all fused multiply-adds, in six "
        f"independent polynomials), and for as many loads and stores as it makes."
    )
    head = ["work", "ns per robot-step, least", "against Euler"]
    report.table(head, [[name, f"{t:.3f}", f"{r:.2f}x"] for name, t, r in table])
    report.say(
        f"A whole PSO iteration takes {np.min(searches.ours) / SHORT * 1e6:.1f} us with "
        f"Euler and {np.min(searches.theirs) / SHORT * 1e6:.1f} us with the exact model: "
        f"{searches.ratio:.2f}x. With obstacle and walls swept, as recommended, a robot-step takes "
        f"{np.min(walls.ours) * ns:.3f} ns with Euler and {np.min(walls.theirs) * ns:.3f} ns with "
        f"the exact model: {walls.ratio:.2f}x."
    )
    for name, ratio in (
        ("rollout as printed", models.ratio),
        ("PSO iteration as printed", searches.ratio),
        ("rollout with obstacle and walls swept", walls.ratio),
    ):
        figure = f"exact model against Euler, {name}"
        report.bar(figure, "<= 2x", f"{ratio:.2f}x", ratio <= 2)
    return report


def _reciprocals(first: int, count: int) -> tuple[float, ...]:
    """Return 1 / first, 1 / (first + 1) and so on, any coefficients of a polynomial."""
    return tuple(1.0 / k for k in range(first, first + count))


_A = _reciprocals(2, 7)
_B = _reciprocals(3, 7)
_C = _reciprocals(4, 7)
_D = _reciprocals(5, 7)
_E = _reciprocals(6, 7)
_F = _reciprocals(7, 8)
_LOOP = {**ENTRY_FAST, "cache": False}


@njit(**_LOOP)
def _arithmetic(q, rows, times):
    """EULER_WORK multiply-adds for each element, `times` over: six polynomials multiplied."""
    out = rows[0]
    for _ in range(times):
        for n in range(q.size):
            z = q[n]
            left_side = polynomial(_A, z) * polynomial(_B, z)
            right = polynomial(_C, z) * polynomial(_D, z)
            out[n] = left_side * right * (polynomial(_E, z) * polynomial(_F, z)) + z
        q[0] = 0.5 * out[0]  # so that no pass can be left out
    return out[0]


@njit(**_LOOP)
def _traffic(rows, times):
    """6 loads and 5 stores for each element, `times` over."""
    a = rows[0]
    b = rows[1]
    c = rows[2]
    d = rows[3]
    e = rows[4]
    f = rows[5]
    for _ in range(times):
        for n in range(a.size):
            s = f[n]
            a_before = a[n]
            c_before = c[n]
            a[n] = b[n] + s
            b[n] = a_before + s
            c[n] = d[n] + s
            d[n] = c_before + s
            e[n] += s
