"""Two rollers to random goals by `pso-mpc`: the error, and the time over that of the closed form.

    python benchmarks/roller_goals.py --goals 20 --out logs/roller-goals        half an hour

Each pair of goals is one trial of experiments/two_rollers.yaml, undisturbed; goals are drawn with a
deviation of 300 um in x and y. Trials that the folder has are not run again. Prints a line for
each, and means.
"""

import argparse
from pathlib import Path

import numpy as np

from tetractl.core.plan import Outcome
from tetractl.experiment.load import load_spec
from tetractl.log.read.reader import read_trial
from tetractl.reproduce.roller_plan import Rollers
from tetractl.results.estimate import distributions
from tetractl.run.interrupt import Interrupt
from tetractl.run.task import log_path, run_trial

SPEC = Path(__file__).parents[1] / "experiments" / "two_rollers.yaml"


def trial(number, out):
    """Return the log of the trial to the goals of this number."""
    folder = out / f"goals-{number:02d}"
    if not log_path(folder, 0).exists():
        goals = np.random.default_rng(number).normal(0, 300, (2, 2)).round(1).tolist()
        sets = [f"robots.{i}.target={goal}" for i, goal in enumerate(goals)]
        folder.mkdir(parents=True, exist_ok=True)
        run_trial(load_spec(SPEC, [*sets, "trials.count=1"]), folder, 0, (), Interrupt())
    return read_trial(log_path(folder, 0))


def main():
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--goals", type=int, default=20)
    parser.add_argument("--out", type=Path, default=Path("logs/roller-goals"))
    given = parser.parse_args()
    errors, ratios = [], []
    for number in range(given.goals):
        log = trial(number, given.out)
        setup, result = log.start.setup, log.result
        assert result is not None
        rollers = Rollers(setup.names, setup.speed / setup.a, setup.a)
        legs = rollers.plan(setup.targets - setup.starts.xy)
        least = sum(leg.seconds for leg in legs)
        ratio = result.duration_s / least
        print(
            f"{number:2} {result.total_error:.2f} um {ratio:.2f} of {least:.1f} s: {result.outcome}"
        )
        errors.append(result.total_error)
        ratios += [ratio] if result.outcome is Outcome.ARRIVED else []
    print(f"arrived: {len(ratios)} of {len(errors)}, within 3 um of both goals")
    for what, values in (("total error [um]", errors), ("time over the least, arrived", ratios)):
        (of,) = distributions(np.array([values]))
        print(f"{what}: {of.mean:.2f} [{of.ci95.low:.2f}, {of.ci95.high:.2f}], n {of.n}")


if __name__ == "__main__":
    main()
