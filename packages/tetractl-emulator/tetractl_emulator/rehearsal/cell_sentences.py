"""The seven sentences, of cells under a field: cells never rest, so what must rest is the field.

| sentence | bound | from |
|---|---|---|
| no field is made blind | `stale`; before a choice, `stream_lost` + `latency` | the spec |
| no field after a stop | wire + `watchdog` + ramp + lag of the coils | the coils |
| poses and the result are true | a body's length for `identity`; `SEEN_UM` | a body, a pixel |
| no streamed pose jumps | a body's length, and two cells' way | a body, the spec's speed |

A field does not hold a cell back, so none must stay inside the arena. Log, exit code and reason are
as of robots, in `outcome_sentences`. A stream that tracks cells itself has its noise, `STREAM_UM`,
for bounds.
"""

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from tetractl_microscope.coils.section import FieldSection

from tetractl.core.poses import Floats, Integers
from tetractl.experiment.lab_section import LabLimits, LabSection
from tetractl.log.read.trial_log import TrialLog
from tetractl_emulator.rehearsal.logged import logged
from tetractl_emulator.rehearsal.outcome_sentences import (
    exit_code_is_right,
    log_is_whole,
    reason_names_a_fault,
)
from tetractl_emulator.rehearsal.truth import (
    EMERGENCY,
    RUN,
    TRANSIT_S,
    UNKNOWN,
    Event,
    Truth,
    Violation,
    VisibleFault,
    time_s,
)

RUNS_ON_S = 0.004  # after the stop in which a command on its way may still make a field
PERIOD_S = 0.025  # between two commands
SENT_S = 0.015  # a tick, and three frames on the wire
LAG_S = 0.02  # of the coils, to 1 % of a current
OFF = 0.01  # greatest current without a field, as a share of the greatest current
WRONG_UM = 60.0  # a body's length
SEEN_UM = 15.0  # the helix of a body, and a pixel
KNOWN_S = 0.5  # until an unknown cell counts as unknown, and the trial ends
STREAM_UM = 7.0  # noise of a stream's pose, the way of a cell in a frame, and rounding
FASTEST = 1.5  # times the speed of the spec, at which a cell may swim
WINDOW_S = 1.0  # for which a stream may be wrong that a cell might have swum
FALSE = ("ghost", "jump", "picture", "slip", "swap", "repeat")  # faults that make poses false
SPECKS = 4  # least debris that shows a knock
LEARNED_S = 1.6  # until the background is learned
MET_UM = 80.0  # largest body: two cells that were as near may have touched


class DishTruth(Truth):
    """The truth of a day with M cells in a dish, of which N are steered."""

    @cached_property
    def poses(self) -> Floats:
        """True poses of all cells at the exposures (T, M, 3) [mm, rad]; NaN before one is born."""
        rows = [[*event["poses"], *event.get("born", ())] for event in self.exposures]
        most = max(map(len, rows), default=0)
        unborn = [np.nan] * 3
        return np.array([row + [unborn] * (most - len(row)) for row in rows])

    @cached_property
    def shown_moving(self) -> list[VisibleFault]:
        """None: cells never rest."""
        return []

    @cached_property
    def currents(self) -> Floats:
        """The greater of both currents at the exposures (T,) [A]."""
        return np.abs([event["currents_a"] for event in self.exposures]).max(axis=1)

    @cached_property
    def ended_s(self) -> float:
        """Time from which our side makes no field: as of robots, but that it is made before."""
        has_begun = self.began_s < np.inf
        return super().ended_s if has_begun else self.abort_s

    @cached_property
    def accepted(self) -> Floats:
        """Poses that our side accepted in these frames (F, N, 2) [mm]; NaN if not tracked."""
        assert isinstance(self.log, TrialLog), "a log was read"
        positions = self.log.mocap[self.has_exposure, :, :2] * self.unit_mm
        is_tracked = self.log.valid[self.has_exposure][..., None]
        return np.where(is_tracked, positions, np.nan)

    @cached_property
    def apart_um(self) -> Floats:
        """Distances of each accepted pose from all true cells (F, N, M) [um]."""
        true = self.poses[self.logged_exposures][:, None, :, :2]
        off = self.accepted[:, :, None] - true
        return 1000 * np.hypot(off[..., 0], off[..., 1])

    @cached_property
    def steered(self) -> Integers:
        """Which cell each robot is (N,): the nearest in the first frame, of a stream its own."""
        if self.numbered:
            return np.arange(len(self.setup.names))
        return np.nan_to_num(self.apart_um[0], nan=np.inf).argmin(axis=1)

    def drives(self, command: Event) -> list[bool]:
        """Return for each robot whether a command makes a field."""
        return [bool(command["flags"] & RUN)] * len(self.setup.names)

    @cached_property
    def moved(self) -> bool:
        """Whether a knock moved all that was in view: what stands did not show it."""
        few_specks = self.day.plan.emulation.get("camera", {}).get("specks", SPECKS) < SPECKS
        specks_hidden = self.met("light", "focus")
        learned_s = self.first_s("client") + LEARNED_S
        knocks = self.faults_of("knocked")
        if few_specks or specks_hidden:
            return bool(knocks)
        return any(knock.span.began_s < learned_s for knock in knocks)

    def may_be_wrong(self, frame: int, robot: int) -> bool:
        """Return whether no camera can tell that a pose is wrong: a cell is taken for one that it
        has met, since names are sure to 90 %; a false pose moves as a cell may swim; or nothing
        that stands showed a knock.
        """
        if self.numbered:
            return self.met(*FALSE)
        if self.moved:
            return True
        own_cell = self.steered[robot]
        nearest_cell = int(np.nan_to_num(self.apart_um[frame, robot], nan=np.inf).argmin())
        if own_cell == nearest_cell:
            return False
        way = self.poses[: self.logged_exposures[frame] + 1]
        apart = way[:, own_cell, :2] - way[:, nearest_cell, :2]
        return bool(1000 * np.nanmin(np.hypot(*apart.T)) < MET_UM)


def cell_violations(truth: DishTruth, lab: LabSection) -> list[Violation]:
    """Return the invariants that a day in a lab has broken."""
    field = lab.actuator
    limits = lab.limits
    assert isinstance(field, FieldSection), "cells are steered by a field"
    driver_late_s = truth.delay_s("late_driver")
    ramp_s = field.current_max_a / field.slew_max_a_s
    off_s = SENT_S + field.watchdog + ramp_s + LAG_S + driver_late_s
    off_a = OFF * field.current_max_a
    violations = [*_commands(truth, limits), *_field(truth, off_s, off_a)]
    if isinstance(truth.log, TrialLog) and len(truth.logged_exposures):
        violations += [*cells_are_not_mistaken(truth, limits), *errors_are_true(truth)]
    violations += log_is_whole(truth)
    if truth.numbered:
        violations += logged(truth)
    return [*violations, *exit_code_is_right(truth), *reason_names_a_fault(truth)]


def _commands(truth: DishTruth, limits: LabLimits) -> Iterator[Violation]:
    """A field needs a new picture; after a stop only stops are sent."""
    turning_s = limits.stream_lost + limits.latency + PERIOD_S + TRANSIT_S
    emergency_s = truth.pressed_s + TRANSIT_S
    for command in truth.commands:
        at_s = time_s(command)
        flags = command["flags"]
        if at_s > emergency_s and not flags & EMERGENCY and at_s > truth.first_s("run"):
            yield Violation("not at rest", at_s, f"flags {flags}")
            return
        if not flags & RUN:
            continue
        if at_s > truth.ended_s + RUNS_ON_S:
            yield Violation("not at rest", at_s, f"{at_s - truth.ended_s:.3f} s after the stop")
            return
        bound_s = limits.stale + TRANSIT_S if at_s >= truth.began_s else turning_s
        unseen_s = min(command["unseen_ms"], default=0.0) / 1000
        if unseen_s > bound_s + truth.late_s:
            yield Violation("driven blind", at_s, f"unseen for {unseen_s:.3f} s")
            return


def _field(truth: DishTruth, off_s: float, off_a: float) -> Iterator[Violation]:
    """The field is off within a time after the stop, and after the last command."""
    if not len(truth.times_s):
        return
    steered_s = [time_s(command) for command in truth.commands if command["flags"] & RUN]
    last_command = np.searchsorted(steered_s, truth.times_s, "right")
    last_steered_s = np.array([-np.inf, *steered_s])[last_command]
    is_on = truth.currents > off_a
    after = is_on & (truth.times_s > truth.left_s + off_s)
    unattended = is_on & (truth.times_s - last_steered_s > off_s)
    for text, wrong in (("after a stop", after), ("unattended", unattended)):
        if wrong.any():
            row = int(wrong.argmax())
            finding = f"a field of {truth.currents[row]:.2f} A {text}"
            yield Violation("not at rest", float(truth.times_s[row]), finding)


def cells_are_not_mistaken(truth: DishTruth, limits: LabLimits) -> Iterator[Violation]:
    """No valid pose is that of another cell, or of none, for long; none is where no cell can be."""
    times_s = truth.times_s[truth.logged_exposures]
    bound_um = WRONG_UM
    bound_s = limits.identity + KNOWN_S
    if truth.numbered:
        bound_s = WINDOW_S
    if truth.numbered and not truth.met(*FALSE):
        bound_um = STREAM_UM
        bound_s = 0.0
    for i, cell in enumerate(truth.steered):
        off_um = truth.apart_um[:, i, cell]
        tracked = np.flatnonzero(~np.isnan(off_um))
        late_um = _speed_um(truth, cell) * truth.late_s
        if truth.numbered and len(tracked):
            yield from _jumps(truth, i, tracked, off_um[tracked] - late_um)
        wrong_since_s: float | None = None
        for frame in tracked.tolist():
            if off_um[frame] <= bound_um + late_um:
                wrong_since_s = None
                continue
            if wrong_since_s is None:
                wrong_since_s = times_s[frame]
            if times_s[frame] - wrong_since_s > bound_s:
                if not truth.may_be_wrong(frame, i):
                    finding = f"{truth.setup.names[i]} by {off_um[frame]:.0f} um"
                    yield Violation("untrue", times_s[frame], finding)
                return


def _jumps(truth: DishTruth, i: int, frames: Integers, off_um: Floats) -> Iterator[Violation]:
    """Yield a pose in the frames (K,) that is further off (K,) than what is streamed as robot i
    can have swum away from it since its pose was true: a body, and two cells' way. None jumps that
    was off in each frame so far, as in a picture that had changed before the run.
    """
    times_s = truth.times_s[truth.logged_exposures[frames]]
    fastest_um_s = FASTEST * float(truth.setup.speed.max()) * truth.setup.metres * 1e6
    true_s = np.where(off_um <= STREAM_UM, times_s, -np.inf)
    last_true_s = np.maximum.accumulate(true_s)
    jumps = off_um > WRONG_UM + 2 * fastest_um_s * (times_s - last_true_s)
    if jumps.any():
        row = int(jumps.argmax())
        finding = f"{truth.setup.names[i]} by {off_um[row]:.0f} um at once"
        yield Violation("untrue", float(times_s[row]), finding)


def errors_are_true(truth: DishTruth) -> Iterator[Violation]:
    """The errors of a complete trial are true, but of lost robots."""
    log = truth.log
    assert isinstance(log, TrialLog), "a log was read"
    if log.result is None or not log.result.outcome.complete or log.stop is None:
        return
    setup = log.start.setup
    unit_um = setup.metres * 1e6
    stop_frame = int(np.abs(log.mocap_ns - log.stop.sent_ns).argmin())
    row = truth.exposure_of_frame[stop_frame]
    if row == UNKNOWN:
        return
    targets_um = setup.targets.reshape(-1, 2) * unit_um
    apart = truth.poses[row, truth.steered, :2] * 1000 - targets_um
    true_errors_um = np.hypot(apart[:, 0], apart[:, 1])
    off_um = np.abs(true_errors_um - np.array(log.result.robot_errors) * unit_um)
    bound_um = STREAM_UM if truth.numbered else SEEN_UM
    for i, cell in enumerate(truth.steered):
        lost = log.result.lost and log.result.lost[i]
        if not lost and off_um[i] > bound_um + _speed_um(truth, cell) * truth.late_s:
            frame = int(np.flatnonzero(truth.logged_exposures == row)[0])
            if not truth.may_be_wrong(frame, i):
                finding = f"{truth.setup.names[i]} by {off_um[i]:.0f} um"
                yield Violation("untrue", truth.times_s[row], finding)
            return


def _speed_um(truth: DishTruth, cell: int) -> float:
    """Return the greatest speed of a cell [um/s]."""
    way = np.diff(truth.poses[:, cell, :2], axis=0)
    swum = np.hypot(way[:, 0], way[:, 1]) / np.diff(truth.times_s)
    return 1000 * float(np.nanquantile(swum, 0.9))
