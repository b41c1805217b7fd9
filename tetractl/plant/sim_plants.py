"""Trials of robots on wheels side by side, each with the bits of `SimPlant`, for learners and large
studies: all numbers are arrays with an axis of trials. Random numbers, and the times at which
frames and commands arrive, are each trial's own."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.clock import NEVER, SECOND, VirtualClock
from tetractl.core.commands import Steer
from tetractl.core.errors import UsageError
from tetractl.core.poses import Bools, Floats, Times
from tetractl.core.setup import Setup
from tetractl.experiment.disturbance import DelayedCommand, overriding
from tetractl.model.motion.rolling import MOVING
from tetractl.model.obstacles import Obstacles
from tetractl.plant.sim_camera import Beats
from tetractl.plant.simulation import SimPlant, SimSection

COMMAND, SILENCE, REPEAT, SEND, END = range(5)  # what comes next in a trial, first at equal times


@dataclass(frozen=True, slots=True)
class Shown:
    """What B trials of N robots show at the end of a control period.

    `poses` (B, 3, N) are x, y, heading in the newest frame received, exposed at `sampled_ns` (B,)
    [ns]; `truth` (B, 3, N) those at the last sample of the true path. `touched` (B,) is True if a
    sample in the period lay in an obstacle or outside the arena.
    """

    poses: Floats
    sampled_ns: Times
    truth: Floats
    touched: Bools


class SimPlants:
    """Simulations of B trials of N robots on wheels, one for each of the `seeds`; `shown` is what
    they show. UsageError for other robots, and for disturbances that act on poses."""

    def __init__(
        self, section: SimSection, setup: Setup, seeds: Sequence[np.random.SeedSequence]
    ) -> None:
        self._section, self._setup = section, setup
        self._plants = [SimPlant(section, setup, VirtualClock(), seed) for seed in seeds]
        self._cameras = [plant.camera for plant in self._plants]
        drives = [plant.wheels for plant in self._plants if plant.wheels is not None]
        acting = self._plants[0].disturbances
        if section.drive is None:
            raise UsageError("only robots on wheels run side by side", "give the plant a 'drive'")
        if any(overriding(acting, method) for method in ("moved", "varied", "measured")):
            raise UsageError("disturbances of poses do not run side by side")
        if section.planning_max_s >= setup.period_s:
            raise UsageError("trials run side by side if planning takes less than a period")
        self._drive, self._host, count = drives[0], drives[0].host, len(seeds)
        self._host.beside([drive.host for drive in drives])
        self._walking = [drive.walking for drive in drives]
        self._bodies = np.concatenate([drive.bodies for drive in drives])
        self._able = np.array([(plant.a > 0) | (plant.speed > 0) for plant in self._plants])
        self._obstacles = Obstacles.of(setup.obstacles)
        self._beats = Beats(section.camera_rate, section.truth_rate)
        self._now_ns, robots = np.zeros(count, np.int64), self._able.shape[1]
        self._next_ns = np.full(count, NEVER)  # when the next command acts
        self._stopping_ns = np.full(self._able.shape, NEVER)  # times of the watchdogs
        self._u = np.zeros(count)
        # frames that may be the newest: measured, and when they were exposed and arrive
        self._seen, self._exposed_ns = np.empty((count, 0, 3, robots)), np.empty(0, np.int64)
        self._arrives_ns, self._steps = np.empty((count, 0), np.int64), 0
        self.shown = self._advance(0, np.full(count, NEVER), self._u)

    def step(self, directions: Floats) -> Shown:
        """Steer the robots of each trial in a direction (B,) [rad], and advance by a period."""
        now, self._steps = self._began_ns, self._steps + 1
        sends = np.array([plant.planned_ns(now) for plant in self._plants])
        end = round(self._steps * self._setup.period_s * SECOND)
        self.shown = self._advance(end, sends, directions)
        return self.shown

    def _advance(self, end: int, sends: Times, directions: Floats) -> Shown:
        """Advance to `end` [ns]; at `sends` (B,) [ns] the new directions (B,) are sent."""
        times, (frames, ticks) = self._beats.due(end)
        kept, noise = self._seen.shape[1], self._expose(times[frames])
        count, robots = self._able.shape
        drawn, path = np.zeros((count, 0, robots)), np.zeros((count, times.size, 3, robots))
        if self._drive.walk > 0:
            shape = np.count_nonzero(ticks), robots
            drawn = np.array([random.standard_normal(shape) for random in self._walking])
        before, ends, sends = np.append(0, times), np.full(count, end), sends.copy()
        while True:
            silent_ns = self._stopping_ns.min(axis=1)
            coming = np.array([self._next_ns, silent_ns, self._host.repeats_ns, sends, ends])
            what, when = coming.argmin(axis=0), coming.min(axis=0)
            # a path has points at its samples, and where a command acts or is repeated
            sampled = np.maximum(before[np.searchsorted(times, when, side="right")], self._now_ns)
            until = np.where(what < SEND, when, sampled)
            walk = self._drive.walk
            self._drive.roll(self._bodies, self._now_ns, until, times, ticks, walk, drawn, path)
            self._seen[:, kept:] = path[:, frames] + noise
            if (what == END).all():
                return self._show(end, path)
            self._act(what, when)
            self._u = np.where(what == SEND, directions, self._u)
            self._transmit((what == REPEAT) | (what == SEND), what == SEND, when)
            sends[what == SEND] = NEVER

    def _expose(self, times: Times) -> Floats:
        """Make room for frames exposed at `times` (F,) [ns]; return their noise (B, F, 3, N)."""
        cameras, listed = self._cameras, times.tolist()
        shape = times.size, 3, self._able.shape[1]
        arrives = np.array([camera.arrivals(listed) for camera in cameras], np.int64)
        self._arrives_ns = np.append(self._arrives_ns, arrives, axis=1)
        self._exposed_ns = np.append(self._exposed_ns, times)
        drawn = np.array([camera.rng.standard_normal(shape) for camera in cameras])
        noise = cameras[0].noise * drawn
        self._seen = np.append(self._seen, noise, axis=1)
        return noise

    def _newest(self, when: Times | int) -> Times:
        """Return the newest frame (B,) that each trial's host has received at times (B,) [ns]."""
        arrived = self._arrives_ns <= np.reshape(when, (-1, 1))
        return arrived.shape[1] - 1 - arrived[:, ::-1].argmax(axis=1)

    def _act(self, what: Times, when: Times) -> None:
        """Let commands and watchdogs act on the robots that they reach."""
        got, wheels = np.zeros(self._able.shape, np.bool_), np.zeros_like(self._bodies[:, 5:7])
        silent_ns = np.full(len(what), NEVER)  # times at which the watchdogs expire
        if (acting := np.flatnonzero(what == COMMAND)).size:
            transits = [self._plants[b].motion.transit for b in acting.tolist()]
            commands = [transit.pop() for transit in transits]
            got[acting] = [command.reached for command in commands]
            wheels[acting] = [command.wheels for command in commands]
            self._next_ns[acting] = [transit.next_ns for transit in transits]
            if self._setup.watchdog_s < np.inf:
                silent_ns[acting] = when[acting] + round(self._setup.watchdog_s * SECOND)
        silences = what == SILENCE
        got[silences] = (self._stopping_ns == when[:, None])[silences]
        targets = self._bodies[:, 5:7]
        np.copyto(targets, wheels, where=got[:, None])
        np.copyto(self._stopping_ns, silent_ns[:, None], where=got)
        moving = targets.any(axis=1) & self._able
        np.copyto(self._bodies[:, MOVING], moving, where=(what <= SILENCE)[:, None])

    def _transmit(self, sending: Bools, new: Bools, when: Times) -> None:
        """Send the held directions, `new` or not, at the times (B,) [ns] in the trials that do."""
        section, newest = self._section, self._newest(when)
        heading, exposed_ns = self._seen[np.arange(len(when)), newest, 2], self._exposed_ns[newest]
        towards, drive = self._u[:, None] + np.zeros_like(heading), np.ones_like(sending)
        speeds = self._host.speeds(sending, new, when, heading, exposed_ns, towards, drive)
        due = np.maximum(when, exposed_ns + round(section.dead_time * SECOND)).tolist()
        heard, u, now = np.ones(heading.shape[1], np.bool_), self._u.tolist(), when.tolist()
        for b in np.flatnonzero(sending).tolist():
            plant = self._plants[b]
            if section.lost_commands > 0:
                heard = plant.losing.uniform(size=heard.size) >= section.lost_commands
            command = DelayedCommand(
                now[b], due[b], Steer(u[b]), heard, None, heading[b], speeds[b, 1]
            )
            plant.motion.transit.send(command, now[b])
            self._next_ns[b] = plant.motion.transit.next_ns

    def _show(self, end: int, path: Floats) -> Shown:
        """Return what the trials show at `end` [ns], and forget older frames."""
        newest, arena = self._newest(end), self._setup.arena
        path = np.append(path, self._bodies[:, None, :3], axis=1)
        low, high = path[:, :, :2].min(axis=1), path[:, :, :2].max(axis=1)  # (B, 2, N) x, y
        low_x, low_y, high_x, high_y = *low.swapaxes(0, 1), *high.swapaxes(0, 1)
        edge = np.minimum(arena.inside(low_x, low_y), arena.inside(high_x, high_y))
        poses, exposed_ns = self._seen[np.arange(len(path)), newest], self._exposed_ns[newest]
        first, self._began_ns = newest.min(), end
        self._seen, self._exposed_ns = self._seen[:, first:], self._exposed_ns[first:]
        self._arrives_ns = self._arrives_ns[:, first:]
        # only the paths that may reach an obstacle are checked sample by sample
        reach, touched = np.hypot(high_x - low_x, high_y - low_y), edge < 0
        near = self._obstacles.distance(path[:, -1, 0], path[:, -1, 1]) <= reach
        x, y = path[:, :, :2].transpose(2, 0, 3, 1)[:, near]
        touched[near] |= self._obstacles.contain(x, y).any(axis=1)
        return Shown(poses, exposed_ns, self._bodies[:, :3].copy(), np.any(touched, axis=1))
