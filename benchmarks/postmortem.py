"""Which realisations give the published controller the published figure? A study on the bench.

    python benchmarks/postmortem.py --trials 10000 --out postmortem.csv   run, or go on
    python benchmarks/postmortem.py --out postmortem.csv --report         print the tables
    python benchmarks/postmortem.py --out postmortem.csv --check 5        try accepted realisations

Every trial is one of `experiments/three_m3pi_paper.yaml` in a realisation of its own, drawn
uniformly from the ranges of `CAUSES` (docs/explanation/bench.md defends them). A row of the CSV is
a realisation and the trial's total error. Rows depend on their
number alone, so that a run can be resumed.

The report fits two polynomials of the second degree in the causes, orthogonal under the ranges, to
the error and to its squared residual: the mean and the variance of the error in a realisation. From
their coefficients follow Sobol's and Shapley's shares of each cause in the variance of the mean,
with intervals by bootstrap; and the posterior of the causes given the published mean and deviation
of 20 trials, by rejection (approximate Bayesian computation) on newly drawn realisations.
"""

import argparse
import csv
import itertools
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tetractl.core.commands import PlantInfo
from tetractl.core.protocols import LabSupervision
from tetractl.core.trial import Result
from tetractl.experiment.controller import Square
from tetractl.experiment.load import LoadedSpec, load_spec, start_of
from tetractl.plant.simulation import SimSection
from tetractl.run.checked_controller import build_controller
from tetractl.run.interrupt import Interrupt
from tetractl.run.run_trial import Trial
from tetractl.run.task import trial_seeds

SPEC = Path(__file__).parents[1] / "experiments" / "three_m3pi_paper.yaml"
SEED = 648
PUBLISHED_N, PUBLISHED_MEAN, PUBLISHED_STD = 20, 648.6, 225.1
WORLDS = 200_000  # drawn for the posterior
BOOTSTRAPS = 200
COUNT_MM_S = 1000 / 127  # of a wheel count
DEAD_ZONE = 6  # counts

DELAYS = ("latency", "planning", "radio", "lag")

Floats = np.ndarray


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause of error: uniform in [low, high], or 0 or 1 with equal chances (`choice`)."""

    name: str
    words: str
    low: float = 0.0
    high: float = 1.0
    choice: bool = False


CAUSES = (
    Cause("latency", "camera latency [s]", 0.003, 0.015),
    Cause("planning", "planning time of a control step [s]", 0.0, 0.15),
    Cause("radio", "radio delay [s]", 0.005, 0.02),
    Cause("loss", "packet loss", 0.0, 0.15),
    Cause("once", "wheel speeds sent once a control step", choice=True),
    Cause("rate", "else sent so often [log10 Hz]", np.log10(20), np.log10(120)),
    Cause("lag", "wheel lag [s]", 0.02, 0.12),
    Cause("gain", "wheel gains wrong by up to", 0.0, 0.1),
    Cause("radius", "wheel distance wrong by up to", 0.0, 0.05),
    Cause("zone", "dead zones wrong by up to 2 counts", choice=True),
    Cause("slip", "slip [rad/sqrt(s)]", 0.0, 0.1),
    Cause("start", "start wrong by up to [mm]; heading 5 mrad a mm", 0.0, 20.0),
    Cause("speed", "speed wrong by up to", 0.0, 0.1),
    Cause("frames", "camera frames lost", 0.0, 0.05),
    Cause("square", "robots drive a square while the first plan is computed", choice=True),
)


def draw(rng: np.random.Generator, count: int) -> Floats:
    """Return realisations (count, causes), each cause scaled to [-1, 1]."""
    worlds = rng.uniform(-1, 1, (count, len(CAUSES)))
    for i, cause in enumerate(CAUSES):
        if cause.choice:
            worlds[:, i] = np.where(worlds[:, i] > 0, 1.0, -1.0)
    return worlds


def values(world: Floats) -> dict[str, float]:
    """Return the causes of a realisation by name, in their units."""
    scaled = zip(CAUSES, world, strict=True)
    return {c.name: float(c.low + (c.high - c.low) * (w + 1) / 2) for c, w in scaled}


def plant(v: dict[str, float]) -> SimSection:
    """Return the bench of a realisation."""
    once = v["once"] > 0.5
    drive: dict[str, Any] = {
        "rate": None if once else 10 ** v["rate"],
        "count": COUNT_MM_S,
        "dead_zone": DEAD_ZONE,
        "dead_zone_error": 2 if v["zone"] > 0.5 else 0,
        "gain_error": v["gain"],
        "radius_error": v["radius"],
        "lag": v["lag"],
    }
    disturbances = [
        {"type": "camera-latency", "mean": v["latency"], "deviation": 0.0004},
        {"type": "frame-loss", "share": v["frames"], "burst": 3.0},
        {"type": "planning-time", "least": v["planning"]},
        {"type": "radio", "delay": v["radio"], "jitter": 0.0003, "loss": v["loss"]},
        {"type": "start-error", "position": v["start"], "heading": 0.005 * v["start"]},
    ]
    return SimSection.model_validate(
        {
            "truth_rate": 240.0,
            "measurement_noise": {"position": 0.2, "heading": 0.003},
            "heading_noise": v["slip"],
            "speed_error": v["speed"],
            "drive": drive,
            "disturbances": disturbances,
        }
    )


def run(spec: LoadedSpec, world: Floats, trial: int) -> Result:
    """Run one trial in a realisation."""
    v = values(world)
    experiment = spec.experiment
    clock, simulated = experiment.plant.clock(), plant(v)
    key, seed = trial_seeds(SEED, trial)
    square = Square(type="square", side=1.0) if v["square"] > 0.5 else None
    return Trial(
        start=start_of(spec, trial, PlantInfo("", True, 0.0, {}), 0),
        plant=simulated.build(experiment.setup, clock, seed, LabSupervision()),
        controller=build_controller(experiment, key),
        first_plan=square or experiment.controller.first_plan,
        clock=clock,
        observers=[],
        interrupt=Interrupt(),
    ).run()


def run_trials(path: Path, trials: int) -> None:
    """Append the trials that are missing up to a number."""
    spec = load_spec(SPEC)
    done = sum(1 for _ in path.open()) - 1 if path.exists() else 0
    worlds = draw(np.random.default_rng(SEED), trials)  # the first are the same for any number
    with path.open("a", newline="") as out:
        writer = csv.writer(out)
        if done <= 0:
            writer.writerow([*(cause.name for cause in CAUSES), "error", "entered", "steps"])
        for trial in range(max(0, done), trials):
            result = run(spec, worlds[trial], trial)
            world = [f"{w:.5g}" for w in worlds[trial]]
            error = f"{result.total_error:.1f}"
            writer.writerow([*world, error, int(result.entered_obstacle), result.steps])
            if trial % 100 == 99:
                out.flush()
                print(f"{trial + 1} of {trials}", file=sys.stderr, flush=True)


@dataclass(frozen=True, slots=True)
class Basis:
    """Polynomials of the second degree, orthonormal in uniform causes and in choices."""

    terms: tuple[tuple[int, ...], ...]  # the causes in each; one twice for its square

    @classmethod
    def quadratic(cls) -> "Basis":
        """Return all terms up to the second degree."""
        every = range(len(CAUSES))
        singles = [(i,) for i in every]
        squares = [(i, i) for i in every if not CAUSES[i].choice]
        return cls(((), *singles, *squares, *itertools.combinations(every, 2)))

    def of(self, worlds: Floats) -> Floats:
        """Return the terms (realisations, terms)."""
        first = np.array([1.0 if c.choice else np.sqrt(3) for c in CAUSES]) * worlds
        second = np.sqrt(5) * (3 * worlds**2 - 1) / 2
        columns = []
        for term in self.terms:
            if len(term) == 2 and term[0] == term[1]:
                columns.append(second[:, term[0]])
            else:
                columns.append(np.prod(first[:, list(term)], axis=1))
        return np.column_stack(columns)


BASIS = Basis.quadratic()


def coefficients(terms: Floats, y: Floats) -> Floats:
    """Return the least-squares coefficients, barely shrunk so that few trials do no harm."""
    ridge = 1e-3 * len(y) * np.eye(terms.shape[1])
    ridge[0, 0] = 0
    return np.linalg.solve(terms.T @ terms + ridge, terms.T @ y)


def chance(terms: Floats, y: Floats, coefs: Floats) -> Floats:
    """Return the variance of each coefficient, for residuals of any spread (White's estimate)."""
    inverse = np.linalg.inv(terms.T @ terms)
    weighted = terms * ((y - terms @ coefs) ** 2)[:, None]
    return np.diag(inverse @ (terms.T @ weighted) @ inverse)


def shares(coefs: Floats, noise: Floats) -> tuple[Floats, Floats, Floats]:
    """Return first-order, total and Shapley shares of the causes in the variance of the mean.

    `noise` is what chance adds to the squares of the coefficients on the mean; without taking it
    away, many small terms would share in a variance that they do not have.
    """
    count = len(CAUSES)
    first, total, shapley = (np.zeros(count) for _ in range(3))
    squares = coefs**2 - noise
    for term, square in zip(BASIS.terms, squares, strict=True):
        members = sorted(set(term))
        for i in members:
            total[i] += square
            shapley[i] += square / len(members)
            if len(members) == 1:
                first[i] += square
    variance = float(squares[1:].sum())
    return first / variance, total / variance, shapley / variance


@dataclass(frozen=True, slots=True)
class Fit:
    """The mean and the deviation of the error in a realisation, as polynomials."""

    mean: Floats
    variance: Floats

    @classmethod
    def of(cls, worlds: Floats, errors: Floats) -> "Fit":
        """Fit both to one trial per realisation."""
        terms = BASIS.of(worlds)
        mean = coefficients(terms, errors)
        return cls(mean, coefficients(terms, (errors - terms @ mean) ** 2))

    def predict(self, worlds: Floats) -> tuple[Floats, Floats]:
        """Return mean and deviation in realisations, the deviation at least 20 mm."""
        terms = BASIS.of(worlds)
        return terms @ self.mean, np.sqrt(np.maximum(terms @ self.variance, 400.0))


def posterior(fit: Fit, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return accepted realisations and the predicted (mean, deviation) of each.

    A realisation is accepted if 20 trials drawn from it come out within one standard error of the
    published mean and of the published deviation.
    """
    worlds = draw(rng, WORLDS)
    mean, std = fit.predict(worlds)
    n = PUBLISHED_N
    drawn_mean = rng.normal(mean, std / np.sqrt(n))
    drawn_std = std * np.sqrt(rng.chisquare(n - 1, WORLDS) / (n - 1))
    near = np.abs(drawn_mean - PUBLISHED_MEAN) <= PUBLISHED_STD / np.sqrt(n)
    near &= np.abs(drawn_std - PUBLISHED_STD) <= PUBLISHED_STD / np.sqrt(2 * (n - 1))
    return worlds[near], np.column_stack([mean, std])[near]


def read(path: Path) -> tuple[Floats, Floats, Floats]:
    """Return realisations, errors and whether an obstacle was entered."""
    rows = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    count = len(CAUSES)
    return rows[:, :count], rows[:, count], rows[:, count + 1]


def interval(values_: Sequence[float] | Floats, digits: int = 2) -> str:
    """Return the middle 95 % as text."""
    low, high = np.percentile(values_, [2.5, 97.5])
    return f"{low:.{digits}f} to {high:.{digits}f}"


def report(path: Path) -> None:
    """Print what the trials tell, as Markdown."""
    worlds, errors, entered = read(path)
    rng = np.random.default_rng(SEED)
    n, fit = len(errors), Fit.of(worlds, errors)
    print(
        f"{n} trials in {n} realisations: error {errors.mean():.1f} mm on the mean, deviation ",
        end="",
    )
    print(f"deviation {errors.std(ddof=1):.1f}; 95 % of them {interval(errors, 0)} mm; ", end="")
    print(f"{100 * entered.mean():.1f} % entered the obstacle.")
    held = rng.random(n) < 0.2
    outside = Fit.of(worlds[~held], errors[~held]).predict(worlds[held])[0]
    explained = 1 - np.var(errors[held] - outside) / np.var(errors[held])
    print(
        f"\nThe polynomial of the mean explains {100 * explained:.0f} % of the variance of single "
    )
    print("trials that it was not fitted to; the rest is chance, or of higher degree.\n")
    terms = BASIS.of(worlds)
    noise = chance(terms, errors, fit.mean)
    samples = []
    for _ in range(BOOTSTRAPS):  # a second draw from a first: the noise of both
        i = rng.integers(0, n, n)
        samples.append(shares(coefficients(terms[i], errors[i]), 2 * noise))
    found, boots = shares(fit.mean, noise), np.array(samples)
    print("| cause | range | first order | total | Shapley [95 %] |\n|---|---|--:|--:|--:|")
    for i in np.argsort(-found[2]):
        c = CAUSES[i]
        span = "no, yes" if c.choice else f"{c.low:.3g} to {c.high:.3g}"
        shapley = f"{found[2][i]:.3f} [{interval(boots[:, 2, i], 3)}]"
        print(f"| {c.words} | {span} | {found[0][i]:.3f} | {found[1][i]:.3f} | {shapley} |")
    accepted, predicted = posterior(fit, rng)
    share = 100 * len(accepted) / WORLDS
    print(
        f"\nOf {WORLDS} realisations drawn from the ranges, "
        f"{len(accepted)} ({share:.2f} %) agree with "
    )
    print(f"the published {PUBLISHED_MEAN} +- {PUBLISHED_STD} mm of {PUBLISHED_N} trials.\n")
    if len(accepted) < 50:
        print("Too few to tell a posterior.")
        return
    print(f"Mean error of the accepted realisations: {interval(predicted[:, 0], 0)} mm (95 %).\n")
    print(
        "| cause | range | posterior mean | posterior 95 % | narrowed by |\n|---|---|--:|--:|--:|"
    )
    for i, c in enumerate(CAUSES):
        physical = c.low + (c.high - c.low) * (accepted[:, i] + 1) / 2
        span = "no, yes" if c.choice else f"{c.low:.3g} to {c.high:.3g}"
        spread = 1.0 if c.choice else 1 / np.sqrt(3)
        narrowed = f"{100 * (1 - accepted[:, i].std() / spread):.0f} %"
        within = "-" if c.choice else interval(physical, 3)
        print(f"| {c.words} | {span} | {physical.mean():.3g} | {within} | {narrowed} |")
    delays = [i for i, cause in enumerate(CAUSES) if cause.name in DELAYS]
    for name, some in (("ranges", draw(rng, 10_000)), ("accepted realisations", accepted)):
        spans = np.array([[CAUSES[i].low, CAUSES[i].high - CAUSES[i].low] for i in delays])
        total = (spans[:, 0] + spans[:, 1] * (some[:, delays] + 1) / 2).sum(axis=1)
        mean, most = f"{total.mean():.3f} s", interval(total, 3)
        print(f"\nSum of all delays in the {name}: mean {mean}, 95 % of them {most} s.")
    pairs = np.corrcoef(accepted.T) - np.eye(len(CAUSES))
    order = np.argsort(-np.abs(np.triu(pairs)), axis=None)[:5]
    print(
        "\nCauses hard to distinguish (strongest correlations among the accepted realisations): ",
        end="",
    )
    told = [(divmod(int(k), len(CAUSES)), pairs.flat[k]) for k in order]
    print("; ".join(f"{CAUSES[i].name} and {CAUSES[j].name} {r:.2f}" for (i, j), r in told) + ".")


def check(path: Path, count: int) -> None:
    """Run 20 trials in each of some accepted realisations, and print what comes out as Markdown."""
    worlds, errors, _ = read(path)
    accepted, predicted = posterior(Fit.of(worlds, errors), np.random.default_rng(SEED))
    chosen = np.random.default_rng(SEED).choice(len(accepted), count, replace=False)
    spec = load_spec(SPEC)
    print("| realisation | predicted mean, deviation | 20 trials |\n|--:|--:|--:|")
    for number, i in enumerate(chosen):
        trials = range((number + 1) * 10**6, (number + 1) * 10**6 + PUBLISHED_N)
        found = np.array([run(spec, accepted[i], trial).total_error for trial in trials])
        told = f"{predicted[i, 0]:.0f} +- {predicted[i, 1]:.0f}"
        print(f"| {number + 1} | {told} | {found.mean():.0f} +- {found.std(ddof=1):.0f} |")


def main() -> None:
    """Run trials, or print the report."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--trials", type=int, default=10_000, metavar="N")
    parser.add_argument("--out", type=Path, required=True, metavar="CSV")
    parser.add_argument("--report", action="store_true")
    parser.add_argument("--check", type=int, default=0, metavar="WORLDS")
    options = parser.parse_args()
    if options.report or options.check:
        if options.report:
            report(options.out)
        if options.check:
            check(options.out, options.check)
    else:
        run_trials(options.out, options.trials)


if __name__ == "__main__":
    main()
