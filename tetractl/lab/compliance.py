"""Whether robots move as they were told: transmissions against camera frames."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from tetractl.core.clock import SECOND
from tetractl.core.poses import Pose

SLACK = 0.3  # share of the way sent that must at least be gone
TURNS_MIN = 0.3  # rad^2/s: less turning was sent in a window than can be judged


@dataclass(slots=True)
class _Account:
    """Sums over a window of one robot: sent and seen, along its heading and around."""

    since_ns: int = 0
    sent: float = 0.0  # way sent [length unit]
    gone: float = 0.0  # way gone along the heading
    turns_sent: float = 0.0  # integral of (turning rate sent)^2 [rad^2/s]
    turns_gone: float = 0.0  # the same with the turning seen


class Compliance:
    """Warns, once a robot and kind, of robots that do not move as told for `window_ns`."""

    def __init__(self, names: Sequence[str], window_ns: int) -> None:
        self.names = tuple(names)
        self.window_ns = window_ns
        self._speed = [0.0] * len(self.names)
        self._turning = [0.0] * len(self.names)
        self._accounts = [_Account() for _ in self.names]
        self._warned: set[str] = set()

    def sent(self, now_ns: int, speed: Sequence[float], turning: Sequence[float]) -> None:
        """Note the last transmission: speeds [length unit/s] and turning rates [rad/s]."""
        for i, (v, w) in enumerate(zip(speed, turning, strict=True)):
            if v == 0.0 or self._speed[i] == 0.0:  # a start or a stop begins a new window
                self._accounts[i] = _Account(now_ns)
            self._speed[i], self._turning[i] = v, w

    def moved(self, i: int, now_ns: int, dt_ns: int, before: Pose, after: Pose) -> None:
        """Note how robot i was seen to move within `dt_ns`."""
        account, dt = self._accounts[i], dt_ns / SECOND
        if self._speed[i] == 0.0:
            return
        middle = before.heading
        dx, dy = after.x - before.x, after.y - before.y
        account.gone += dx * math.cos(middle) + dy * math.sin(middle)
        account.sent += self._speed[i] * dt
        turned = math.remainder(after.heading - before.heading, math.tau)
        account.turns_sent += self._turning[i] ** 2 * dt
        account.turns_gone += self._turning[i] * turned

    def warnings(self, now_ns: int) -> tuple[str, ...]:
        """Return the warnings that are new since the last call."""
        found: list[str] = []
        for i, (name, account) in enumerate(zip(self.names, self._accounts, strict=True)):
            if self._speed[i] == 0.0 or now_ns - account.since_ns < self.window_ns:
                continue
            self._accounts[i] = _Account(now_ns)
            fault = _fault(account)
            if fault and (text := f"{name} {fault}") not in self._warned:
                self._warned.add(text)
                found.append(text)
        return tuple(found)


def _fault(account: _Account) -> str:
    if account.sent <= 0.0:
        return ""
    if account.gone < -SLACK * account.sent:
        return "moves backward: is its heading offset wrong, or its drive inverted?"
    if account.turns_sent > TURNS_MIN and account.turns_gone < -SLACK * account.turns_sent:
        return "turns the wrong way: is its drive swapped or inverted?"
    if account.gone < SLACK * account.sent:
        return "does not move as told: power, drive or link?"
    return ""
