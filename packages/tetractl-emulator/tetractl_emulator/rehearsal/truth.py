"""What truly happened on a day, as arrays: the poses, the commands, and what was accepted.

The observer of a rehearsal shares no code with the guard: distances are computed here.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.errors import TetractlError
from tetractl.core.poses import Bools, Floats
from tetractl.core.setup import Setup
from tetractl.core.shape import Shape
from tetractl.experiment.lab_section import LabLimits
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.reader import trial_of
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import TrialLog
from tetractl_emulator.process import AFTER_NS
from tetractl_emulator.rehearsal.day import Day
from tetractl_emulator.rehearsal.schedule import FRAME_S

RUN, EMERGENCY = 1, 2  # flags of a command
LATE_FRAMES = ("late_pictures", "late_frames", "reordered")
MOVES_MM_S, MOVES_RAD_S = 10.0, 0.1  # motion that pictures of a second show plainly
NEAR_S = 0.02  # largest difference of the times of a picture


def nearest_exposures(
    stamps_s: Floats, exposures_s: Floats, suspended: Sequence[tuple[float, float]]
) -> list[int | None]:
    """Return for the time of each picture (F,) [s] the number of the exposure (T,) [s] next to it;
    None if none is near.

    A picture that comes while our program is `suspended` (from, to) [s] waits, and gets its time
    from when it was taken at last: which exposure it shows is not known.
    """
    apart_s = np.abs(exposures_s[:, None] - stamps_s)
    known = apart_s.min(axis=0) < NEAR_S
    for began_s, ended_s in suspended:
        known &= (stamps_s < began_s) | (stamps_s > ended_s)
    nearest = apart_s.argmin(axis=0).tolist()
    return [row if sure else None for row, sure in zip(nearest, known.tolist(), strict=True)]


@dataclass
class Truth:
    """The truth of a day in a lab of N robots; times are seconds since the emulation began."""

    day: Day
    setup: Setup
    limits: LabLimits
    watchdog_s: float

    def of(self, event: str, **facts: Any) -> list[dict[str, Any]]:
        """Return the recorded events of a kind."""
        kind = self._kinds.get(event, [])
        return [e for e in kind if facts.items() <= e.items()] if facts else kind

    @cached_property
    def _kinds(self) -> dict[str, list[dict[str, Any]]]:
        kinds = dict[str, list[dict[str, Any]]]()
        for one in self.day.events:
            kinds.setdefault(one["event"], []).append(one)
        return kinds

    def first(self, event: str, **facts: Any) -> float:
        """Return the time of the first such event; infinite if there is none."""
        return min((e["t_ns"] / SECOND for e in self.of(event, **facts)), default=np.inf)

    @cached_property
    def times(self) -> Floats:
        """Times of the exposures (T,)."""
        return np.array([e["t_ns"] for e in self.of("truth")]) / SECOND

    @cached_property
    def poses(self) -> Floats:
        """True poses at the exposures (T, N, 3) [mm, rad]."""
        count = len(self.setup.names)
        return np.array([e["poses"] for e in self.of("truth")]).reshape(-1, count, 3)

    @cached_property
    def driving(self) -> Floats:
        """Greatest speed of a robot's wheels at the exposures (T, N) [mm/s]; 0 if not known."""
        still = [[0.0, 0.0]] * len(self.setup.names)
        wheels = [e.get("wheels", still) for e in self.of("truth")]
        return np.abs(np.array(wheels)).reshape(-1, len(still), 2).max(axis=2)

    @cached_property
    def commanded(self) -> Floats:
        """Times of the commands [s]."""
        return np.array([command["t_ns"] for command in self.of("command")]) / SECOND

    def drives(self, command: dict[str, Any]) -> list[bool]:
        """Return which robots a command drives: `drives` or, of robots with `wheels`, if not 0."""
        running = bool(command["flags"] & RUN)
        own = [running and any(wheels) for wheels in command.get("wheels", ())]
        return command.get("drives", own)

    @cached_property
    def unseen(self) -> Floats:
        """Time since each robot was last shown (T, N) [s]; 0 if not known, as in a dish that has
        other cells than those that are steered.
        """
        count = len(self.setup.names)
        unknown = [0.0] * count
        rows = [event["unseen_ms"] for event in self.of("truth")]
        shown = [row if len(row) == count else unknown for row in rows]
        return np.array(shown).reshape(-1, count) / 1000

    @cached_property
    def acting(self) -> Floats:
        """For how long each command (C,) acts [s]: until the next, or until a watchdog stops robots
        that hear none.
        """
        after = np.append(self.commanded[1:], self.alive_s) - self.commanded
        return np.clip(after, 0.0, self.watchdog_s)

    @cached_property
    def undirected(self) -> Floats:
        """How long before each command (C,) the log has the controller's last direction [s]; 0
        before the first, without a log, and after the last in a log that was broken off.
        """
        if self.trial is None or not self.trial.steps:
            return np.zeros(len(self.commanded))
        sent_s = np.array([step.command.sent_ns for step in self.trial.steps]) / SECOND
        last = np.searchsorted(sent_s, self.commanded, "right") - 1
        known = last >= 0
        if self.trial.result is None:
            known &= last < len(sent_s) - 1
        return np.where(known, self.commanded - sent_s[last], 0.0)

    def status(self, flag: int) -> Bools:
        """Return a flag of the robots' firmware at the exposures (T, N): 1 running, 2 emergency
        stopped, 4 silent; False if not known."""
        none = [0] * len(self.setup.names)
        rows = [e.get("status", none) for e in self.of("truth")]
        return (np.array(rows, dtype=int).reshape(-1, len(none)) & flag) > 0

    @cached_property
    def driven(self) -> list[tuple[float, float]]:
        """The times in which the guard let robots be driven: begin and end of each [s]."""
        found = list[tuple[float, float]]()
        events = [(e["t_ns"] / SECOND, e["state"] in ("run", "hold")) for e in self.of("guard")]
        since = np.inf
        for at, drives in [*events, (self.alive_s, False)]:
            if drives:
                since = min(since, at)
            elif since < at:
                found.append((since, at))
                since = np.inf
        return found

    @cached_property
    def killed(self) -> bool:
        """Whether the process was killed."""
        return any(fault.get("signal") == "KILL" for _, _, fault in self.faults)

    @cached_property
    def numbered(self) -> bool:
        """Whether frames have numbers."""
        return any(e["frame"] for e in self.of("truth"))

    @cached_property
    def dated(self) -> bool:
        """Whether frames have times of their own, too: readings of a mat have those of arrival."""
        return self.numbered and not self.setup.sight.coarse

    @cached_property
    def late_s(self) -> float:
        """By how much frames without a time of their own, which count as new, were older than they
        seemed: late ones, and those that waited in the wire [s].
        """
        if self.dated:
            return 0.0
        late = [f["by"] for _, _, f in self.faults if f["fault"] in LATE_FRAMES]
        slept = [f["for"] for _, _, f in self.faults if f["fault"] == "stopped"]
        busy = [f["seconds"] for _, _, f in self.faults if f["fault"] == "busy"]
        return sum(late) + sum(slept) + sum(busy)

    @property
    def alive_s(self) -> float:
        """Time at which our side ended; the emulation goes on alone for a moment."""
        return float(self.times[-1]) - AFTER_NS / SECOND if len(self.times) else 0.0

    @cached_property
    def began_s(self) -> float:
        """Time from which the guard lets the controller steer; infinite if it never does."""
        return self.first("guard", state="run")

    @cached_property
    def abort_s(self) -> float:
        """Time of the guard's abort; infinite without one."""
        return self.first("guard", state="abort")

    @cached_property
    def ended_s(self) -> float:
        """Time from which our side drives no more: the abort, or when the guard left its run for
        good.
        """
        states = [(e["t_ns"] / SECOND, e["state"]) for e in self.of("guard")]
        driven = [i for i, (_, state) in enumerate(states) if state in ("run", "hold")]
        after = states[driven[-1] + 1 :] if driven else []
        return min(self.abort_s, after[0][0] if after else np.inf)

    @cached_property
    def faults(self) -> list[tuple[float, float, dict[str, Any]]]:
        """The faults that became visible: begin and end [s], and the fault as drawn."""
        ends = {e["row"]: e["t_ns"] / SECOND for e in self.of("fault", phase="end")}
        return [
            (e["t_ns"] / SECOND, ends.get(e["row"], np.inf), dict(self.day.plan.sorted[e["row"]]))
            for e in self.of("fault", phase="start")
        ]

    def met(self, *kinds: str) -> bool:
        """Return whether one of these faults became visible, by the names of scripts."""
        return any(fault["fault"] in kinds for _, _, fault in self.faults)

    @cached_property
    def shown_moving(self) -> list[tuple[float, float, str]]:
        """When a camera plainly showed motion of robots that may rest: begin, end [s], fault."""
        shown = list[tuple[float, float, str]]()
        for began_s, ended_s, fault in self.faults:
            slides = fault["fault"] == "ghost" or fault.get("creeps", False)
            speed_mm_s = math.hypot(*fault.get("by", (0.0, 0.0))) / FRAME_S if slides else 0.0
            rate = abs(fault.get("turn", 0.0)) / FRAME_S if slides else 0.0
            if speed_mm_s > MOVES_MM_S or rate > MOVES_RAD_S:
                shown.append((began_s, ended_s, str(fault["kind"])))
        return shown

    @cached_property
    def log(self) -> TrialLog | str:
        """The log, or why it cannot be read; "" if there is none."""
        if self.day.log is None:
            return ""
        try:
            return trial_of(self.raw)
        except (TetractlError, ValueError, KeyError) as error:
            return f"{type(error).__name__}: {error}"

    @cached_property
    def raw(self) -> RawLog:
        """The records of the log; LogError if it has none."""
        assert self.day.log is not None, "there is a log"
        return scan(self.day.log)

    @property
    def trial(self) -> TrialLog | None:
        """The log, None if there is none that can be read."""
        return self.log if isinstance(self.log, TrialLog) else None

    @property
    def reason(self) -> str:
        """Why the trial was aborted, or the run refused; "" if it was neither."""
        if isinstance(self.log, TrialLog) and self.log.result is not None:
            result = self.log.result
            return result.reason if result.outcome == "aborted" else ""
        said = re.search(r"^error: (?:trial 1: )?(.*)", self.day.said, re.MULTILINE)
        return said[1] if said else ""

    @cached_property
    def rows(self) -> list[int | None]:
        """The exposure of each frame in the log: by its number or, as pictures have none, by its
        time on the host's clock; None if there is no such exposure.
        """
        assert isinstance(self.log, TrialLog), "a log was read"
        if self.numbered:
            numbers, at = dict[int, list[int]](), self.times * SECOND
            for i, e in enumerate(self.of("truth")):
                numbers.setdefault(int(e["frame"]), []).append(i)
            shots = zip(self.log.frames.tolist(), self.log.mocap_ns.tolist(), strict=True)
            # a counter that goes back repeats numbers
            found = ((numbers.get(number, ()), ns) for number, ns in shots)
            return [min(own, key=lambda i: abs(at[i] - ns), default=None) for own, ns in found]
        host = self.times.copy()
        for began, _, fault in self.faults:
            if fault["fault"] == "host_clock":
                host += fault["by"] * (self.times >= began)
        suspended = [(at, end) for at, end, fault in self.faults if fault["fault"] == "stopped"]
        return nearest_exposures(self.log.mocap_ns / SECOND, host, suspended)

    @property
    def final(self) -> int:
        """The exposure of the last frame in the log, after which people may move robots."""
        known = [row for row in self.rows if row is not None]
        return known[-1] if known else -1

    @cached_property
    def accepted(self) -> Floats:
        """Poses that our side accepted (T, N, 3) [mm, rad], each held until the next; NaN where
        there is none, and after the end of a log that was broken off.
        """
        found = np.full((len(self.times), len(self.setup.names), 3), np.nan)
        if isinstance(self.log, TrialLog) and len(self.log.frames):
            mm = self.setup.metres * 1000
            for row, poses in zip(self.rows, self.log.mocap, strict=True):
                if row is not None:
                    found[row] = poses * (mm, mm, 1.0)
            logged = np.flatnonzero(~np.isnan(found).all(axis=(1, 2)))
            last = len(found) if self.log.result is not None else int(logged.max(initial=0))
            for row in range(1, last):
                found[row] = np.where(np.isnan(found[row]), found[row - 1], found[row])
        return found

    @cached_property
    def fresh(self) -> Bools:
        """Whether the log has a pose of a robot that was exposed then (T, N)."""
        found = np.zeros((len(self.times), len(self.setup.names)), bool)
        if isinstance(self.log, TrialLog):
            own = self.log.exposed_ns == self.log.mocap_ns[:, None]
            for row, valid in zip(self.rows, self.log.valid & own, strict=True):
                if row is not None:
                    found[row] = valid
        return found

    @cached_property
    def repeated(self) -> Bools:
        """Whether a pose accepted equals the one before to the last bit (T, N)."""
        found = np.zeros(self.fresh.shape, bool)
        found[1:] = (self.accepted[1:] == self.accepted[:-1]).all(axis=-1)
        return found & self.fresh

    @cached_property
    def error(self) -> Floats:
        """Distance between a pose accepted and the true one (T, N) [mm]; 0 before the first."""
        off = self.accepted - self.poses
        return np.nan_to_num(np.hypot(off[..., 0], off[..., 1]))

    @cached_property
    def depth(self) -> Floats:
        """How far a robot is beyond the rim or inside an obstacle (T, N) [mm]; 0 if it is not.

        The rim is for centres, as in the spec; obstacles are grown by the body's radius.
        """
        mm, arena = self.setup.metres * 1000, self.setup.arena
        x, y = self.poses[..., 0] / mm, self.poses[..., 1] / mm
        over = [arena.left - x, x - arena.right, arena.bottom - y, y - arena.top]
        over += [self.setup.body_radius - apart(shape, x, y) for shape in self.setup.obstacles]
        return np.maximum(np.max(over, axis=0), 0.0) * mm


def apart(shape: Shape, x: Floats, y: Floats) -> Floats:
    """Return the distance of points to a shape, negative inside; a circle has one corner."""
    at, corners = x + 1j * y, shape.corners[:, 0] + 1j * shape.corners[:, 1]
    if len(corners) == 1:
        return np.abs(at - corners[0]) - shape.radius
    nearest, turned = np.full(at.shape, np.inf), np.zeros(at.shape)
    for one, two in zip(corners, np.roll(corners, -1), strict=True):
        part = np.clip(((at - one) / (two - one)).real, 0.0, 1.0)
        nearest = np.minimum(nearest, np.abs(at - one - part * (two - one)))
        turned += np.angle((two - at) / (one - at))
    return np.where(np.abs(turned) > np.pi, -nearest, nearest) - shape.radius
