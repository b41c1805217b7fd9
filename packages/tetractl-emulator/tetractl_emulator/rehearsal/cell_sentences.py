"""The seven sentences, of cells under a field: cells never rest, so what must rest is the field.

| sentence | bound | from |
|---|---|---|
| no field is made blind | `stale`; before a choice, `stream_lost` + `latency` | the spec |
| no field after a stop | wire + `watchdog` + ramp + lag of the coils | the coils |
| poses and the result are true | a body's length for `identity`; `SEEN_UM` | a body, a pixel |
| no streamed pose jumps | a body's length, and two cells' way | a body, the spec's speed |

A field does not hold a cell back, so none must stay inside the arena. Log, exit code and reason are
as of robots, in `sentences`. A stream that tracks cells itself has its noise, `STREAM_UM`, for
bounds.
"""

from collections.abc import Iterator
from functools import cached_property
from typing import Any

import numpy as np
from tetractl_microscope.coils.section import FieldSection

from tetractl.core.poses import Floats, Integers
from tetractl.experiment.lab_section import LabLimits, LabSection
from tetractl.log.read.trial_log import TrialLog
from tetractl_emulator.rehearsal.logged import logged
from tetractl_emulator.rehearsal.sentences import (
    AIR_S,
    exit_code_is_right,
    log_is_whole,
    reason_names_a_fault,
)
from tetractl_emulator.rehearsal.truth import EMERGENCY, RUN, Truth
from tetractl_emulator.rehearsal.violation import Violation

PERIOD_S = 0.025  # between two commands
SENT_S = 0.015  # a tick, and three frames on the wire
LAG_S = 0.02  # of the coils, to 1 % of a current
OFF = 0.01  # greatest current without a field, as a share of the greatest current
WRONG_UM, SEEN_UM = 60.0, 15.0  # a body's length; the helix of a body, and a pixel
KNOWN_S = 0.5  # until an unknown cell counts as unknown, and the trial ends
STREAM_UM = 7.0  # noise of a stream's pose, the way of a cell in a frame, and rounding
FASTEST = 1.5  # times the speed of the spec, at which a cell may swim
WINDOW_S = 1.0  # for which a stream may be wrong that a cell might have swum
FALSE = ("ghost", "jump", "picture", "slip", "swap", "repeat")  # faults that make poses false
SPECKS, LEARNED_S = 4, 1.6  # least debris that shows a knock; until the background is learned
MET_UM = 80.0  # largest body: two cells that were as near may have touched


class DishTruth(Truth):
    """The truth of a day with M cells in a dish, of which N are steered."""

    @cached_property
    def poses(self) -> Floats:
        """True poses of all cells at the exposures (T, M, 3) [mm, rad]; NaN before one is born."""
        rows = [[*e["poses"], *e.get("born", ())] for e in self.of("truth")]
        most = max(map(len, rows), default=0)
        return np.array([[*row, *[[np.nan] * 3] * (most - len(row))] for row in rows])

    @cached_property
    def shown_moving(self) -> list[tuple[float, float, str]]:
        """None: cells never rest."""
        return []

    @cached_property
    def currents(self) -> Floats:
        """The greater of both currents at the exposures (T,) [A]."""
        return np.abs([e["currents_a"] for e in self.of("truth")]).max(axis=1)

    @cached_property
    def ended_s(self) -> float:
        """Time from which our side makes no field: as of robots, but that it is made before."""
        return min(self.abort_s, super().ended_s) if self.began_s < np.inf else self.abort_s

    @cached_property
    def seen(self) -> Integers:
        """The exposures of the logged frames, without those that are not known."""
        return np.array([row for row in self.rows if row is not None], int)

    @cached_property
    def accepted(self) -> Floats:
        """Poses that our side accepted in these frames (F, N, 2) [mm]; NaN if not tracked."""
        assert isinstance(self.log, TrialLog), "a log was read"
        known = np.array([row is not None for row in self.rows], bool)
        poses = self.log.mocap[known, :, :2] * (self.log.start.setup.metres * 1000)
        return np.where(self.log.valid[known][..., None], poses, np.nan)

    @cached_property
    def apart_um(self) -> Floats:
        """Distances of each accepted pose from all true cells (F, N, M) [um]."""
        off = self.accepted[:, :, None] - self.poses[self.seen][:, None, :, :2]
        return 1000 * np.hypot(off[..., 0], off[..., 1])

    @cached_property
    def steered(self) -> Integers:
        """Which cell each robot is (N,): the nearest in the first frame, of a stream its own."""
        if self.numbered:
            return np.arange(len(self.setup.names))
        return np.nan_to_num(self.apart_um[0], nan=np.inf).argmin(axis=1)

    def drives(self, command: dict[str, Any]) -> list[bool]:
        """Return for each robot whether a command makes a field."""
        return [bool(command["flags"] & RUN)] * len(self.setup.names)

    @cached_property
    def moved(self) -> bool:
        """Whether a knock moved all that was in view: what stands did not show it."""
        few = self.day.plan.emulation.get("camera", {}).get("specks", SPECKS) < SPECKS
        hidden, learned_s = self.met("light", "focus"), self.first("client") + LEARNED_S
        knocks = [began for began, _, fault in self.faults if fault["fault"] == "knocked"]
        return any(few or hidden or began < learned_s for began in knocks)

    def mistaken(self, frame: int, robot: int) -> str:
        """Return the class of a wrong pose: a cell is taken for one that it has met, or a false
        pose moves as a cell may swim; "" if it is of none.
        """
        if self.numbered:
            return "slow: as a cell may swim" if self.met(*FALSE) else ""
        if self.moved:
            return "knocked: nothing showed that stands"
        own = self.steered[robot]
        other = int(np.nan_to_num(self.apart_um[frame, robot], nan=np.inf).argmin())
        way = self.poses[: self.seen[frame] + 1]
        apart = way[:, own, :2] - way[:, other, :2]
        met = own != other and 1000 * np.nanmin(np.hypot(*apart.T)) < MET_UM
        return "met: names are sure to 90 %" if met else ""


def cell_violations(truth: DishTruth, lab: LabSection) -> list[Violation]:
    """Return the invariants that a day in a lab has broken."""
    field, limits = lab.actuator, lab.limits
    assert isinstance(field, FieldSection), "cells are steered by a field"
    behind = [f["by"] for _, _, f in truth.faults if f["fault"] == "late_driver"]
    ramp_s = field.current_max_a / field.slew_max_a_s
    off_s = SENT_S + field.watchdog + ramp_s + LAG_S + sum(behind)
    found = [*_commands(truth, limits), *_field(truth, off_s, OFF * field.current_max_a)]
    if isinstance(truth.log, TrialLog) and len(truth.seen):
        found += [*_identity(truth, limits), *_result(truth)]
    found += [*log_is_whole(truth), *(logged(truth) if truth.numbered else ())]
    return [*found, *exit_code_is_right(truth), *reason_names_a_fault(truth)]


def _commands(truth: DishTruth, limits: LabLimits) -> Iterator[Violation]:
    """A field needs a new picture; after a stop only stops are sent."""
    turning_s = limits.stream_lost + limits.latency + PERIOD_S + AIR_S
    emergency = truth.first("fault", name="emergency", phase="start") + AIR_S
    for command in truth.of("command"):
        at, flags = command["t_ns"] / 1e9, command["flags"]
        if at > emergency and not flags & EMERGENCY and at > truth.first("run"):
            yield Violation("not at rest", at, f"flags {flags}")
            return
        if not flags & RUN:
            continue
        if at > truth.ended_s + 0.004:
            yield Violation("not at rest", at, f"{at - truth.ended_s:.3f} s after the stop")
            return
        within = limits.stale + AIR_S if at >= truth.began_s else turning_s
        unseen = min(command["unseen_ms"], default=0.0) / 1000
        if unseen > within + truth.late_s:
            yield Violation("driven blind", at, f"unseen for {unseen:.3f} s")
            return


def _field(truth: DishTruth, off_s: float, off_a: float) -> Iterator[Violation]:
    """The field is off within a time after the stop, and after the last command."""
    if not len(truth.times):
        return
    killed = [at for at, _, fault in truth.faults if fault.get("signal") == "KILL"]
    steers = [e["t_ns"] / 1e9 for e in truth.of("command") if e["flags"] & RUN]
    last = np.array([-np.inf, *steers])[np.searchsorted(steers, truth.times, "right")]
    made = truth.currents > off_a
    after = made & (truth.times > min([truth.ended_s, *killed]) + off_s)
    unattended = made & (truth.times - last > off_s)
    for text, wrong in (("after a stop", after), ("unattended", unattended)):
        if wrong.any():
            row = int(wrong.argmax())
            found = f"a field of {truth.currents[row]:.2f} A {text}"
            yield Violation("not at rest", float(truth.times[row]), found)


def _identity(truth: DishTruth, limits: LabLimits) -> Iterator[Violation]:
    """No valid pose is that of another cell, or of none, for long; none is where no cell can be."""
    at = truth.times[truth.seen]
    wrong_um, known_s = WRONG_UM, WINDOW_S if truth.numbered else limits.identity + KNOWN_S
    if truth.numbered and not truth.met(*FALSE):
        wrong_um, known_s = STREAM_UM, 0.0
    for i, own in enumerate(truth.steered):
        off = truth.apart_um[:, i, own]
        known = np.flatnonzero(~np.isnan(off))
        late_um = _speed_um(truth, own) * truth.late_s
        if truth.numbered and len(known):
            yield from _jumps(truth, i, known, off[known] - late_um)
        far = off[known] > wrong_um + late_um
        since: float | None = None
        for frame, wrong in zip(known.tolist(), far.tolist(), strict=True):
            since = (at[frame] if since is None else since) if wrong else None
            if since is not None and at[frame] - since > known_s:
                found = f"{truth.setup.names[i]} by {off[frame]:.0f} um"
                yield Violation("untrue", at[frame], found, truth.mistaken(frame, i))
                return


def _jumps(truth: DishTruth, i: int, known: Integers, off_um: Floats) -> Iterator[Violation]:
    """Yield a pose in the frames `known` (K,) that is further off (K,) than what is streamed as
    robot i can have swum away from it since its pose was true: a body, and two cells' way.
    """
    at = truth.times[truth.seen[known]]
    fastest_um_s = FASTEST * float(truth.setup.speed.max()) * truth.setup.metres * 1e6
    true_s = np.where(off_um <= STREAM_UM, at, -np.inf)
    true_s = np.maximum.accumulate(np.maximum(true_s, at[0]))
    jumps = off_um > WRONG_UM + 2 * fastest_um_s * (at - true_s)
    if jumps.any():
        row = int(jumps.argmax())
        found = f"{truth.setup.names[i]} by {off_um[row]:.0f} um at once"
        yield Violation("untrue", float(at[row]), found)


def _result(truth: DishTruth) -> Iterator[Violation]:
    """The errors of a complete trial are true, but of lost robots."""
    log = truth.log
    assert isinstance(log, TrialLog), "a log was read"
    if log.result is None or not log.result.outcome.complete or log.stop is None:
        return
    setup, um = log.start.setup, log.start.setup.metres * 1e6
    frame = int(np.abs(log.mocap_ns - log.stop.sent_ns).argmin())
    if (row := truth.rows[frame]) is None:
        return
    apart = truth.poses[row, truth.steered, :2] * 1000 - setup.targets.reshape(-1, 2) * um
    off = np.abs(np.hypot(apart[:, 0], apart[:, 1]) - np.array(log.result.robot_errors) * um)
    seen_um = STREAM_UM if truth.numbered else SEEN_UM
    for i, own in enumerate(truth.steered):
        lost = log.result.lost and log.result.lost[i]
        if not lost and off[i] > seen_um + _speed_um(truth, own) * truth.late_s:
            frame = int(np.flatnonzero(truth.seen == row)[0])
            found = f"{truth.setup.names[i]} by {off[i]:.0f} um"
            yield Violation("untrue", truth.times[row], found, truth.mistaken(frame, i))
            return


def _speed_um(truth: DishTruth, own: int) -> float:
    """Return the greatest speed of a cell [um/s]."""
    way = np.diff(truth.poses[:, own, :2], axis=0)
    swum = np.hypot(way[:, 0], way[:, 1]) / np.diff(truth.times)
    return 1000 * float(np.nanquantile(swum, 0.9))
