"""Made-up batches for tests."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from testkit import trials
from testkit.trials import THREE_M3PI
from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.trial import PlantInfo, Result, Verdict
from tetractl.log.read.trial_log import Origin, ResultSummary
from tetractl.spec.experiment import Experiment
from tetractl.statistics.describe import BatchStatistics, describe
from tetractl.statistics.open_batch import Batch, Damaged

REFERENCE = {"source": "Figure 5", "n": 20, "mean": 648.6, "std": 225.1}
DISTURBED = {"type": "sim", "heading_noise": 0.05}


def experiment(robots: int = 3, **fields: Any) -> Experiment:
    controller = {"type": "pso-mpc"} | fields.pop("controller", {})
    simple = {"robots": THREE_M3PI["robots"][:robots], "obstacles": [], "controller": controller}
    return trials.experiment(**simple | fields)


def result(errors: Sequence[float], **fields: Any) -> Result:
    n = len(errors)
    values: dict[str, Any] = {
        "outcome": Outcome.SEQUENCE_COMPLETED,
        "reason": "no signal left",
        "steps": 31,
        "duration_s": 6.2,
        "total_error": float(np.sum(errors)),
        "robot_errors": tuple(float(error) for error in errors),
        "verdict": Verdict(Poses.from_array(np.zeros((n, 3))), (False,) * n, (100.0,) * n),
        "solve_ns": (1_000_000, 2_000_000, 3_000_000),
        "deadline_misses": 0,
    }
    return Result(**(values | fields))


def trial(
    path: str, spec: Experiment, result: Result, index: int = 0, **fields: Any
) -> ResultSummary:
    origin = Origin.from_spec(spec, PlantInfo("", True, 120.0, {}))
    facts: dict[str, Any] = {"seed": 1, "origin": origin, "recovered": False, "digest": None}
    return ResultSummary(path, spec, trial=index, result=result, **(facts | fields))


def batch(
    errors: Sequence[Sequence[float]], spec: Experiment | None = None, **fields: Any
) -> list[ResultSummary]:
    """One trial a row of robot errors."""
    spec = spec or experiment(len(errors[0]))
    return [
        trial(f"trial-{i:03d}.mcap", spec, result(row, **fields), i) for i, row in enumerate(errors)
    ]


def group(
    trials: Sequence[ResultSummary], damaged: Sequence[Damaged] = (), name: str = ""
) -> BatchStatistics:
    """The trials and earlier attempts described."""
    return describe(Batch.from_results(trials, damaged), name)
