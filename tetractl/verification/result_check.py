"""Compare the result in a log with the other records, from which it must follow.

The errors must follow from the final poses, the final poses must occur in a logged frame, and a
lab's result must name the obstacles that the logged path enters. If this code wrote the log, a
guard computes again, from the logged commands and frames, how fast a lab's robots turned off
course. A log that somebody changed together with its digests can still pass: only a signature
protects against that (docs/reference/durability.md).
"""

from collections.abc import Iterator

import numpy as np

from tetractl.core.protocols import EMULATED_NAME
from tetractl.core.trial import EMULATED_DEVICES_FACT, EMULATED_PLANT, HALTS_FACT, Result
from tetractl.lab.guard import GuardState
from tetractl.lab.guard_observer import build_guard
from tetractl.lab.guard_rules import GuardRules
from tetractl.log.provenance import TRIAL_CODE_KEY
from tetractl.log.read.reader import trial_path
from tetractl.log.read.trial_log import TrialLog
from tetractl.model.path_check import check_path
from tetractl.run.task import code_hash
from tetractl.spec.lab_section import LabSection
from tetractl.verification.comparison import Difference, first_difference
from tetractl.verification.guard_replay import camera_frame, lab_checks, note_speeds, ordered_events

TURN_ERRORS_MAX = 1.0
"""Maximum difference between a stated turn and the recomputed turn, in standard errors.

In virtual time, both turns are the same. In real time, a frame that arrives in the last millisecond
before a start may be processed before or after the start. All blocks of motion then begin one frame
earlier or later, and a turn differs by up to 0.71 standard errors (20 emulated trials of cubes,
whose poses are coarse).
"""
TURN_STD_DIFFERENCE_MAX = 0.1
"""Maximum relative difference of a turn's standard error, for the same reason: up to 0.046."""


def result_differences(log: TrialLog, result: Result) -> Iterator[Difference]:
    """Yield the contradictions between the result in a log and the other records.

    Args:
        log: An undamaged log.
        result: The result to compare, usually `log.result`.

    Yields:
        A difference for each contradicted value. Only the first contradicted error is yielded.
    """
    yield from _check_emulation(log)
    recomputed = Result.from_verdict(
        log.start.setup,
        result.verdict,
        outcome=result.outcome,
        reason=result.reason,
        duration_s=result.duration_s,
        solve_ns=tuple(step.solve_ns for step in log.steps),
        deadline_misses=result.deadline_misses,
        drove=result.drove,
        route=log.route,
        estimate=log.last_estimate,
    )
    difference = first_difference(recomputed, result, name="result")
    if difference is not None:
        yield difference
    has_ended = result.outcome.complete or not np.isnan(result.verdict.final.array()).all()
    if has_ended and len(log.mocap) and not log.start.plant.simulated:
        yield from _check_final_poses(log, result)
    is_own = log.facts.get(TRIAL_CODE_KEY) == code_hash(log.experiment)
    # if the guard aborted a trial, its log does not say when
    if is_own and result.outcome.complete:
        yield from _check_turning_rates(log, result)


def _check_emulation(log: TrialLog) -> Iterator[Difference]:
    """Yield a difference if a trial with emulated devices does not name them.

    Otherwise it could be mistaken for a trial in a real lab.
    """
    plant = log.start.plant
    reports_emulation = any(EMULATED_NAME in value for value in plant.facts.values())
    is_emulated = log.experiment.plant.type == EMULATED_PLANT or reports_emulation
    if is_emulated and not plant.facts.get(EMULATED_DEVICES_FACT):
        problem = "does not say which devices are emulated"
        yield Difference(None, f"run.facts.{EMULATED_DEVICES_FACT}", problem)


def _check_final_poses(log: TrialLog, result: Result) -> Iterator[Difference]:
    """Yield the contradictions of a lab's final poses and entered obstacles with its frames.

    Robots that stop have the poses of the last frame. Cells swim on after the stop, so their final
    poses may come from any frame.
    """
    final = result.verdict.final.array()
    swim_on = log.start.plant.facts.get(HALTS_FACT) == "no"
    frames = log.mocap if swim_on else log.mocap[-1:]
    if not any(np.array_equal(frame, final, equal_nan=True) for frame in frames):
        yield Difference(None, "result.final", "differs from the robots' last poses")
    path, _ = trial_path(log)
    is_known = np.asarray(np.isfinite(path).all(axis=2))
    entered = check_path(log.start.setup, path, is_known, result.verdict.final).entered
    for i, (stated, recomputed) in enumerate(zip(result.verdict.entered, entered, strict=True)):
        if stated != recomputed:
            problem = f"states {stated}, but the path in the log gives {recomputed}"
            yield Difference(None, f"result.entered.{i}", problem)


def _check_turning_rates(log: TrialLog, result: Result) -> Iterator[Difference]:
    """Yield the contradictions of the turning rates in a lab's result with commands and frames.

    Rates may differ by TURN_ERRORS_MAX standard errors, and the standard errors by the fraction
    TURN_STD_DIFFERENCE_MAX.
    """
    verdict = result.verdict
    rates, errors = _recompute_turning_rates(log)
    if len(rates) != len(verdict.turn):
        problem = f"states {len(verdict.turn)} turns, but the frames show {len(rates)}"
        yield Difference(None, "result.turn", problem)
        return
    stated = zip(verdict.turn, verdict.turn_std, rates, errors, strict=True)
    for i, (rate, stated_std, recomputed, std) in enumerate(stated):
        if np.isfinite(std) and not abs(rate - recomputed) <= TURN_ERRORS_MAX * std:
            yield Difference(
                None, f"result.turn.{i}", f"states {rate}, but the frames show {recomputed}"
            )
        if not np.isclose(stated_std, std, rtol=TURN_STD_DIFFERENCE_MAX):
            yield Difference(None, f"result.turn_std.{i}", f"states {stated_std} instead of {std}")


def _recompute_turning_rates(log: TrialLog) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Compute how fast robots on wheels turned off course, with standard errors [rad/s].

    A guard finds these rates when it sees the trial again. Both are empty if it finds none.
    """
    lab = log.experiment.plant
    setup = log.start.setup
    if not isinstance(lab, LabSection) or setup.wheel_radius is None:
        return (), ()
    guard = build_guard(GuardRules.from_setup(setup, lab.limits), lab_checks(log.experiment))
    guard.pass_preflight()
    for event in ordered_events(log):
        if not event.is_command:
            guard.check_frame(camera_frame(log, event.row))
            continue
        command = log.commands[event.row]
        if command.stops:
            guard.end_run()
        elif guard.state is GuardState.READY:
            guard.start_run(event.t_ns)
        note_speeds(guard, log, command)
    return guard.drift.estimate_turning()
