"""What the controller's model may lack, as disturbances of the plant.

Numbers without another source are assumed: no lab has measured them. Places and times are drawn for
each trial.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from tetractl.core.commands import Steer
from tetractl.core.poses import Floats, Poses, wrap
from tetractl.core.setup import Setup
from tetractl.plant.disturbances.camera import FrozenCameraSection
from tetractl.spec.disturbance import DelayedCommand, Disturbance, DisturbanceSection

Random = np.random.Generator


class Unmodelled(Disturbance):
    """One of the disturbances below, of a `size` whose meaning each of them says."""

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
        """Draw what is constant in a trial."""

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        self.xy = poses.xy.T
        self.heading = poses.heading
        return poses


class Later(Unmodelled):
    """From some time between 3 and 8 s on, commands act later by `size` [s]."""

    def draw(self) -> None:
        self.since_ns = 1e9 * self.random.uniform(3, 8)

    def sent(self, command: DelayedCommand) -> DelayedCommand:
        if command.sent_ns < self.since_ns:
            return command
        return replace(command, due_ns=command.due_ns + round(1e9 * self.size))


class SparseRadio(Unmodelled):
    """Of the directions only one in `size` [s] gets out; stops and turns all do."""

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
    """Twice for 4 s only 10 pictures a second arrive, later by `size` [s], from 1 to 14 s on."""

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
        """Return how far (N,) they really turn in a time; without this, `by` [rad]."""
        return by


class Sides(Turning):
    """a is 1 + `size` of the spec's to one side, drawn for each robot, and 1 - `size` to the other:
    a exp(+-k) with the sign of the turn."""

    def draw(self) -> None:
        self.more = self.size * self.random.choice([-1.0, 1.0], self.count)

    def turned(self, by: Floats, seconds: float) -> Floats:
        return by + self.more * np.abs(by)


class Saturated(Turning):
    """No robot turns faster than `size` [rad/s]."""

    def turned(self, by: Floats, seconds: float) -> Floats:
        return np.clip(by, -self.size * seconds, self.size * seconds)


class Slide(Unmodelled):
    """Moving robots slide downhill by `size` [mm/s], and turn there at 0.1 rad/s at most."""

    def draw(self) -> None:
        self.down = self.random.uniform(-np.pi, np.pi)

    def moved(self, poses: Poses, moving: Floats, seconds: float, time_s: float) -> Poses:
        way = self.size * seconds * moving
        turned = 0.1 * seconds * moving
        x = poses.x + way * np.cos(self.down)
        y = poses.y + way * np.sin(self.down)
        return Poses(x, y, poses.heading + turned * np.sin(self.down - poses.heading))


class Strip(Unmodelled):
    """On a strip `size` [mm] wide across the arena, speed is 70 % and a is 85 %."""

    def draw(self) -> None:
        self.at = self.middle[0, 0] + self.random.uniform(-300, 300)

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        on = np.abs(self.xy[0] - self.at) < self.size / 2
        return a * np.where(on, 0.85, 1.0), speed * np.where(on, 0.7, 1.0)


class Lens(Unmodelled):
    """The camera shows what is `size` of its distance too far out at the corners, and less within
    by the square of the distance from the middle; headings are those of the picture."""

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
    """One robot's battery ends between 2 and `size` [s]; the camera sees it standing."""

    def draw(self) -> None:
        self.lives = np.arange(self.count) != self.random.integers(self.count)
        self.at_s = self.random.uniform(2, self.size)

    def varied(self, a: Floats, speed: Floats, time_s: float) -> tuple[Floats, Floats]:
        works = self.lives | (time_s < self.at_s)
        return a * works, speed * works


class Avoid(Unmodelled):
    """Each cell now and then, after `size` [s] on average, swims backwards for 0.5 s and turns for
    0.5 s by up to 90 degrees, as ciliates do that meet something."""

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
}


class UnmodelledSection(DisturbanceSection):
    """One of these disturbances."""

    type: str
    size: float

    def build(self, setup: Setup, rng: Random) -> Unmodelled:
        return KINDS[self.type](self.size, setup, rng)
