"""Compares the result in a log with the records that it follows from.

The errors must follow from the final poses, the final poses must be those of a logged frame, and a
lab's result must name the obstacles that the logged path enters. A log that somebody changed
together with its digests can still pass: only a signature protects against that
(docs/reference/durability.md).
"""

from collections.abc import Iterator

import numpy as np

from tetractl.core.protocols import EMULATED_NAME
from tetractl.core.trial import EMULATED_DEVICES, EMULATED_PLANT, HALTS, Result
from tetractl.log.read.reader import trial_path
from tetractl.log.read.trial_log import TrialLog
from tetractl.model.path_check import check_path
from tetractl.replay.comparison import Difference, first_difference


def result_differences(log: TrialLog, result: Result) -> Iterator[Difference]:
    """Yield what the result states and the other records contradict.

    Args:
        log: An undamaged log.
        result: The result to compare, usually `log.result`.

    Yields:
        A difference for each contradicted value. Of the errors, only the first one.
    """
    yield from _emulation(log)
    again = Result.of(
        log.start.setup,
        result.verdict,
        outcome=result.outcome,
        reason=result.reason,
        duration_s=result.duration_s,
        solve_ns=tuple(step.solve_ns for step in log.steps),
        deadline_misses=result.deadline_misses,
        drove=result.drove,
        tour=log.tour,
    )
    difference = first_difference(again, result, name="result")
    if difference is not None:
        yield difference
    has_ended = result.outcome.complete or not np.isnan(result.verdict.final.array()).all()
    if has_ended and len(log.mocap) and not log.start.plant.simulated:
        yield from _places(log, result)


def _emulation(log: TrialLog) -> Iterator[Difference]:
    """Yield that a trial of emulated devices does not name them: so it cannot pass for a lab's."""
    plant = log.start.plant
    says_so = any(EMULATED_NAME in value for value in plant.facts.values())
    is_emulated = log.experiment.plant.type == EMULATED_PLANT or says_so
    if is_emulated and not plant.facts.get(EMULATED_DEVICES):
        text = "does not say which devices are emulated"
        yield Difference(None, f"run.facts.{EMULATED_DEVICES}", text)


def _places(log: TrialLog, result: Result) -> Iterator[Difference]:
    """Yield how a lab's final poses and entered obstacles contradict its frames.

    Robots that stop have the poses of the last frame. Cells swim on after the stop, so their final
    poses may come from any frame.
    """
    final = result.verdict.final.array()
    swim_on = log.start.plant.facts.get(HALTS) == "no"
    frames = log.mocap if swim_on else log.mocap[-1:]
    if not any(np.array_equal(frame, final, equal_nan=True) for frame in frames):
        yield Difference(None, "result.final", "differs from the robots' last poses")
    path, _ = trial_path(log)
    is_known = np.asarray(np.isfinite(path).all(axis=2))
    entered = check_path(log.start.setup, path, is_known, result.verdict.final).entered
    for i, (stated, again) in enumerate(zip(result.verdict.entered, entered, strict=True)):
        if stated != again:
            text = f"states {stated}, but the logged path gives {again}"
            yield Difference(None, f"result.entered.{i}", text)
