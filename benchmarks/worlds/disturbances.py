"""Disturbances of the plant that the controller's model does not contain.

Numbers without a source are assumptions, because no lab has measured them. Places and times are
sampled for each trial.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer
from tetractl.core.poses import Floats, Poses, wrap
from tetractl.core.setup import Setup
from tetractl.plant.disturbances.camera import FrozenCameraSection
from tetractl.spec.disturbance import DelayedCommand, Disturbance, DisturbanceSection

Random = np.random.Generator


class Unmodelled(Disturbance):
    """Base class of the disturbances below. Each of them defines what its `size` means."""

    def __init__(self, size: float, setup: Setup, random: Random) -> None:
        self.size = size
        self.random = random
        self.count = len(setup.names)
        arena = setup.arena
        self.middle = np.array([[arena.left + arena.right], [arena.bottom + arena.top]]) / 2
        self.reach = float(np.hypot(arena.width, arena.height)) / 2  # from the middle to a corner
        self.xy = np.tile(self.middle, self.count)
        self.heading = np.zeros(self.count)
        self.draw()

    def draw(self) -> None:
        """Sample the values that are constant during a trial."""

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        self.xy = poses.xy.T
        self.heading = poses.heading
        return poses


class Later(Unmodelled):
    """Delays all commands by `size` [s], starting between 3 and 8 s."""

    def draw(self) -> None:
        self.since_ns = 1e9 * self.random.uniform(3, 8)

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        if command.sent_ns < self.since_ns:
            return command
        return replace(command, due_ns=command.due_ns + round(1e9 * self.size))


class SparseRadio(Unmodelled):
    """Lets only one direction per `size` [s] pass, but all stops and turns."""

    def draw(self) -> None:
        self.next_ns = 0

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        if not isinstance(command.action, Steer):
            return command
        if command.sent_ns < self.next_ns:
            return replace(command, reached=np.zeros_like(command.reached))
        self.next_ns = command.sent_ns + round(1e9 * self.size)
        return command


class SlowPictures(Unmodelled):
    """Slows the camera twice for 4 s, starting between 1 and 14 s.

    Only 10 images per second then arrive, later by `size` [s].
    """

    def draw(self) -> None:
        section = FrozenCameraSection(type="frozen-camera", times=2, duration=4)
        self.spells = section.draw(self.random)
        self.shown = -1

    def received(self, exposed_ns: int, received_ns: int) -> int | None:
        if not self.spells.include(exposed_ns / 1e9):
            return received_ns
        before = self.shown
        self.shown = exposed_ns // 100_000_000
        return received_ns + round(1e9 * self.size) if self.shown > before else None


class Turning(Unmodelled):
    """Changes how far robots have turned since the last call."""

    before: Floats | None = None

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        before = poses.heading if self.before is None else self.before
        self.before = before + self.turned(wrap(poses.heading - before), seconds)
        return Poses(poses.x, poses.y, self.before)

    def turned(self, by: Floats, seconds: float) -> Floats:
        """Return how far (N,) robots really turn in a time. Without the disturbance, it would be
        `by` [rad].
        """
        return by


class Sides(Turning):
    """Makes robots turn faster to one side, sampled for each robot.

    a is (1 + `size`) times the spec's to this side, and (1 - `size`) times to the other: a exp(+-k)
    with the sign of the turn.
    """

    def draw(self) -> None:
        self.more = self.size * self.random.choice([-1.0, 1.0], self.count)

    def turned(self, by: Floats, seconds: float) -> Floats:
        return by + self.more * np.abs(by)


class Saturated(Turning):
    """Limits the turning rate of all robots to `size` [rad/s]."""

    def turned(self, by: Floats, seconds: float) -> Floats:
        return np.clip(by, -self.size * seconds, self.size * seconds)


class Slide(Unmodelled):
    """Makes moving robots slide downhill at `size` [mm/s], and turn there at up to 0.1 rad/s."""

    def draw(self) -> None:
        self.down = self.random.uniform(-np.pi, np.pi)

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        way = self.size * seconds * moving
        turned = 0.1 * seconds * moving
        x = poses.x + way * np.cos(self.down)
        y = poses.y + way * np.sin(self.down)
        return Poses(x, y, poses.heading + turned * np.sin(self.down - poses.heading))


class Strip(Unmodelled):
    """Slows robots on a strip of `size` [mm] across the arena: 70 % of the speed, 85 % of a."""

    def draw(self) -> None:
        self.at = self.middle[0, 0] + self.random.uniform(-300, 300)

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        on = np.abs(self.xy[0] - self.at) < self.size / 2
        return a * np.where(on, 0.85, 1.0), speed * np.where(on, 0.7, 1.0)


class Lens(Unmodelled):
    """Distorts the camera's image like a lens.

    Positions are shown too far out, by the fraction `size` of their distance at the corners, and
    less further in, with the square of the distance from the middle. Headings are those in the
    image.
    """

    def measured(self, poses: Poses, valid: Any, time_s: float) -> tuple[Poses, Any]:
        ahead = np.array([np.cos(poses.heading), np.sin(poses.heading)])
        x, y = self._shown(poses.xy.T)
        x_ahead, y_ahead = self._shown(poses.xy.T + ahead)
        turned = np.arctan2(y_ahead - y, x_ahead - x)
        return Poses(x, y, poses.heading + wrap(turned - poses.heading)), valid

    def _shown(self, xy: Floats) -> Floats:
        off = (xy - self.middle) / self.reach
        return xy + self.size * self.reach * (off**2).sum(axis=0) * off


class Dead(Unmodelled):
    """Empties one robot's battery between 2 and `size` [s]; the camera still sees the robot."""

    def draw(self) -> None:
        self.lives = np.arange(self.count) != self.random.integers(self.count)
        self.at_s = self.random.uniform(2, self.size)

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        works = self.lives | (time_s < self.at_s)
        return a * works, speed * works


class Avoid(Unmodelled):
    """Makes each cell turn away now and then, as ciliates do when they meet something.

    On average every `size` [s], a cell swims backwards for 0.5 s, and turns for 0.5 s by up to 90
    degrees.
    """

    def draw(self) -> None:
        self.next_s = self.random.exponential(self.size, self.count)
        self.by = np.zeros(self.count)

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        ended = time_s >= self.next_s + 1
        drawn = self.random.exponential(self.size, self.count)
        by = self.random.uniform(-np.pi, np.pi, self.count)  # [rad/s]
        self.next_s = np.where(ended, time_s + drawn, self.next_s)
        self.by = np.where(ended, by, self.by)
        self.since_s = time_s - self.next_s
        turns = np.where(self.since_s >= 0.5, moving, 0.0)
        return Poses(poses.x, poses.y, poses.heading + self.by * seconds * turns)

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        back = self.since_s >= 0
        turns = self.since_s >= 0.5
        return a, speed * np.where(turns, 0.0, np.where(back, -1.0, 1.0))


class SlowTurning(Turning):
    """Makes the turning rate follow the commanded one with the time constant `size` [s]."""

    def draw(self) -> None:
        self.rate = np.zeros(self.count)

    def turned(self, by: Floats, seconds: float) -> Floats:
        if seconds == 0:
            return by
        by, self.rate = _lagging(self.rate, by / seconds, seconds, self.size)
        return by


class Proportional(Turning):
    """Makes robots turn in proportion to the angle to the direction, instead of to its sine.

    The turning rate is `size` times a times the angle.
    """

    def draw(self) -> None:
        self.due: list[tuple[float, float]] = []  # time [s] and direction [rad] of each command
        self.direction = np.nan

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        action = command.action
        direction = action.direction if isinstance(action, Steer) else np.nan
        self.due.append((command.due_ns / SECOND, direction))
        return command

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        self.a = a
        while self.due and self.due[0][0] <= time_s:
            self.direction = self.due.pop(0)[1]
        return a, speed

    def turned(self, by: Floats, seconds: float) -> Floats:
        if np.isnan(self.direction):
            return by
        angle = wrap(self.direction - self.before)
        return np.where(by == 0, by, self.size * self.a * angle * seconds)


class Rolling(Unmodelled):
    """Makes the speed follow the commanded one with the time constant `size` [s].

    Robots therefore roll on after a stop.
    """

    def draw(self) -> None:
        self.speed = np.zeros(self.count)
        self.place: Floats | None = None

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        place = poses.xy.T if self.place is None else self.place
        if seconds > 0:
            commanded = np.hypot(*(poses.xy.T - place)) / seconds
            way, self.speed = _lagging(self.speed, commanded, seconds, self.size)
            place = place + way * np.array([np.cos(poses.heading), np.sin(poses.heading)])
        self.place = place
        return Poses(place[0], place[1], poses.heading)


def _lagging(
    before: Floats, commanded: Floats, seconds: float, lag_s: float
) -> tuple[Floats, Floats]:
    """Let a rate follow the commanded one like a low-pass filter.

    Args:
        before: The rate at the beginning, per second.
        commanded: The commanded rate, per second.
        seconds: The time that passes [s].
        lag_s: The time constant [s].

    Returns:
        The integral of the rate over this time, and the rate at its end.
    """
    kept = np.exp(-seconds / lag_s)
    integral = commanded * seconds + (before - commanded) * lag_s * (1 - kept)
    return integral, commanded + (before - commanded) * kept


class FillingBuffer(Unmodelled):
    """Delays directions more and more, by up to `size` [s] within 12 s.

    Then the buffer is emptied, and the delay grows again from 0.
    """

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        if not isinstance(command.action, Steer):
            return command
        later_s = self.size * (command.sent_ns / SECOND % 12) / 12
        return replace(command, due_ns=command.due_ns + round(later_s * SECOND))


class Pivot(Unmodelled):
    """Makes the camera measure a point `size` [mm] away from the middle between the wheels.

    The direction from the middle to this point is sampled for each robot.
    """

    def draw(self) -> None:
        self.bearing = self.random.uniform(-np.pi, np.pi, self.count)

    def measured(self, poses: Poses, valid: Any, time_s: float) -> tuple[Poses, Any]:
        angle = poses.heading + self.bearing
        x = poses.x + self.size * np.cos(angle)
        return Poses(x, poses.y + self.size * np.sin(angle), poses.heading), valid


class Askew(Unmodelled):
    """Makes each cell swim at an angle of `size` [rad] to its body.

    The side is sampled for each cell. The angle wanders by 0.1 rad within about 2 s.
    """

    def draw(self) -> None:
        self.mean = self.size * self.random.choice([-1.0, 1.0], self.count)
        self.wander = 0.1 * self.random.normal(size=self.count)
        self.place: Floats | None = None

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        place = poses.xy.T if self.place is None else self.place
        kept = np.exp(-seconds / 2)
        noise = self.random.normal(size=self.count)
        self.wander = kept * self.wander + 0.1 * np.sqrt(1 - kept**2) * noise
        cos = np.cos(self.mean + self.wander)
        sin = np.sin(self.mean + self.wander)
        x, y = poses.xy.T - place
        self.place = place + np.array([cos * x - sin * y, sin * x + cos * y])
        return Poses(self.place[0], self.place[1], poses.heading)


KINDS: dict[str, type[Unmodelled]] = {
    "later": Later,
    "sparse-radio": SparseRadio,
    "slow-pictures": SlowPictures,
    "sides": Sides,
    "saturated": Saturated,
    "slide": Slide,
    "strip": Strip,
    "lens": Lens,
    "dead": Dead,
    "avoid": Avoid,
    "slow-turning": SlowTurning,
    "proportional": Proportional,
    "rolling": Rolling,
    "filling-buffer": FillingBuffer,
    "pivot": Pivot,
    "askew": Askew,
}


class UnmodelledSection(DisturbanceSection):
    """The section of a spec for one of these disturbances."""

    type: str
    size: float

    def build(self, setup: Setup, rng: Random) -> Unmodelled:
        return KINDS[self.type](self.size, setup, rng)
