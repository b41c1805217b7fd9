"""Whether robots do as they are told: what was sent against what the cameras saw."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from tetractl.core.clock import SECOND
from tetractl.core.poses import Pose

SLACK = 0.3  # share of the way told that must at least be gone


@dataclass(slots=True)
class _Account:
    """Sums over a window of one robot: told and done, along its heading and around."""

    since_ns: int = 0
    told: float = 0.0  # way told [length unit]
    gone: float = 0.0  # way gone along the heading
    turns_told: float = 0.0  # integral of (turning told)^2 [rad^2/s]
    turns_done: float = 0.0  # the same with the turning seen


class Conduct:
    """Warns, once a robot and kind, of robots that do not move as told for `window_ns`."""

    def __init__(self, names: Sequence[str], window_ns: int) -> None:
        self.names = tuple(names)
        self.window_ns = window_ns
        self._speed = [0.0] * len(self.names)
        self._turning = [0.0] * len(self.names)
        self._accounts = [_Account() for _ in self.names]
        self._said: set[str] = set()

    def told(self, now_ns: int, speed: Sequence[float], turning: Sequence[float]) -> None:
        """Take what the robots were last sent: [length unit/s] and [rad/s]."""
        for i, (v, w) in enumerate(zip(speed, turning, strict=True)):
            if v == 0.0 or self._speed[i] == 0.0:  # a start or a stop begins a new window
                self._accounts[i] = _Account(now_ns)
            self._speed[i], self._turning[i] = v, w

    def moved(self, i: int, now_ns: int, dt_ns: int, before: Pose, after: Pose) -> None:
        """Take what the cameras saw robot i do within `dt_ns`."""
        account, dt = self._accounts[i], dt_ns / SECOND
        if self._speed[i] == 0.0:
            return
        middle = before.heading
        dx, dy = after.x - before.x, after.y - before.y
        account.gone += dx * math.cos(middle) + dy * math.sin(middle)
        account.told += self._speed[i] * dt
        turned = math.remainder(after.heading - before.heading, math.tau)
        account.turns_told += self._turning[i] ** 2 * dt
        account.turns_done += self._turning[i] * turned

    def complaints(self, now_ns: int) -> tuple[str, ...]:
        """Return what is new since the last call."""
        found: list[str] = []
        for i, (name, account) in enumerate(zip(self.names, self._accounts, strict=True)):
            if self._speed[i] == 0.0 or now_ns - account.since_ns < self.window_ns:
                continue
            self._accounts[i] = _Account(now_ns)
            complaint = _complaint(account)
            if complaint and (text := f"{name} {complaint}") not in self._said:
                self._said.add(text)
                found.append(text)
        return tuple(found)


def _complaint(account: _Account) -> str:
    if account.told <= 0.0:
        return ""
    if account.gone < -SLACK * account.told:
        return "drives backward: are its wheels inverted, or its heading offset wrong?"
    if account.turns_told > 0.3 and account.turns_done < -SLACK * account.turns_told:
        return "turns the wrong way: are its wheels swapped?"
    if account.gone < SLACK * account.told:
        return "does not move as told: battery, motor or radio?"
    return ""
