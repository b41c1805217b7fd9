"""Steering by hand: reads what a person wants robots to do, from keys and mouse or from a file.

    arrows        the robots turn to the right, up, to the left, down
    the mouse     drag anywhere: they turn to the direction of the drag
    p             a simulation pauses, and shows where each arrow leads; p again goes on
    space, q      stop, which ends the trial

A file has a line `SECONDS KEY` for each key, `#` before a comment; the first key starts the robots,
and times count from it.
"""

import math
import re
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from tetractl.core.errors import UsageError
from tetractl.core.setup import Setup
from tetractl.spec.yaml.spec_files import read_text
from tetractl.tools.table.table import pluralize

ARROWS = {"right": 0.0, "up": math.pi / 2, "left": math.pi, "down": -math.pi / 2}
"""Directions [rad] by key."""
STOPS = {"space", "q"}
PAUSE = "p"
HINTS = ("arrows steer", "SPACE ends", "P: pause", "mouse: drag")
"""What the keys do in a simulation, the most important first."""
LAB_HINTS = ("ESC: EMERGENCY STOP", "arrows steer", "SPACE ends", "mouse: drag")
"""What they do in a lab."""
GO_ON = "enter"
AGAIN = "r"
LEAVE = "q"
"""Answers to the question what to do after a trial.

No arrow is one of them, so that a hand that still steers answers nothing.
"""
WHY = (
    "All robots received the same directions, but each turns at its own rate, so every turn "
    "changes the gaps between them. The right turns in the right order bring each robot "
    "home. This is hard because no robot can be moved alone: what brings one home takes "
    "others away."
)
"""Text that explains, after a trial, why steering by hand is hard.

It takes eight lines of the smallest panel.
"""
PAUSED = "PAUSED. Try arrows: dots show where each leads. Nothing moves until you press P."
"""Text shown during a pause."""
BYTE_ORDER_MARK = "\ufeff"
"""Character that some editors write at the beginning of a file."""
WAIT_S = 0.01
"""Time between two checks whether a key has been pressed [s]."""
CELL_HEIGHT = 2.0
"""Height of a character cell of a terminal, relative to its width."""
_MOUSE = re.compile(r"<(?P<button>\d+);(?P<column>\d+);(?P<row>\d+)(?P<kind>[Mm])")
"""What a terminal sends of the mouse after its escape character, in its mode 1006."""
PRESSED = 0
DRAGGED = 32
"""Number of the button while the mouse moves with the left one pressed.

PRESSED is its number at the moment when it is pressed.
"""
MOUSE_ON = "\x1b[?1002h\x1b[?1006h"
MOUSE_OFF = "\x1b[?1006l\x1b[?1002l"


@dataclass(frozen=True, slots=True)
class Wish:
    """What the person who steers wants at present: a direction, a stop, or a pause.

    Attributes:
        direction: The direction [rad]. None before the first key.
        stops: Whether to stop.
        pauses: Whether to pause.
        drag_from: Where a drag of the mouse began: column and row of the screen. None if there is
            none.
    """

    direction: float | None = None
    stops: bool = False
    pauses: bool = False
    drag_from: tuple[int, int] | None = None

    @property
    def answer(self) -> float | None:
        """The direction that the person wants [rad], None to stop."""
        return None if self.stops else self.direction

    def after(self, key: str) -> "Wish":
        """Return the person's new wish after a key or a movement of the mouse.

        Keys without a function do not change it. A stop cannot be taken back.
        """
        if key in ARROWS:
            return replace(self, direction=ARROWS[key])
        if key in STOPS:
            return replace(self, stops=True)
        if key == PAUSE and self.direction is not None:
            return replace(self, pauses=not self.pauses)
        mouse = _MOUSE.fullmatch(key)
        return self if mouse is None else self._dragged(mouse)

    def _dragged(self, mouse: re.Match[str]) -> "Wish":
        column = int(mouse["column"])
        row = int(mouse["row"])
        button = int(mouse["button"])
        if button == PRESSED and mouse["kind"] == "M":
            return replace(self, drag_from=(column, row))
        if button != DRAGGED or self.drag_from is None or self.drag_from == (column, row):
            return self
        right = column - self.drag_from[0]
        up = CELL_HEIGHT * (self.drag_from[1] - row)
        return replace(self, direction=math.atan2(up, right))


class HandKeys:
    """Reads what a person wants from keys and mouse of a terminal. It is a context manager.

    Only a simulation `can_pause`. Two threads use this object. The thread of the keys calls
    `press`, and replaces the wish as a whole. The thread of the trial calls `ask`, which reads it.
    The same holds for the answer and `await_answer`.
    """

    def __init__(self, has_ended: Callable[[], bool], can_pause: bool = False) -> None:
        self._wish = Wish()
        self._answer = ""
        self._has_ended = has_ended
        self._can_pause = can_pause

    def press(self, key: str) -> None:
        """Take a key that was pressed, given by its name, and change the person's wish.

        The key may also be the answer for which `await_answer` waits. The pause key is ignored if
        the plant cannot pause.
        """
        name = key.lower() if len(key) == 1 else key  # P is p
        if name != PAUSE or self._can_pause:
            self._wish = self._wish.after(name)
        if name in (GO_ON, AGAIN, LEAVE):
            self._answer = name

    def stop(self) -> None:
        """Stop the robots, as the space bar does, and answer LEAVE."""
        self._wish = replace(self._wish, stops=True)
        self._answer = LEAVE

    def forget(self) -> None:
        """Forget earlier answers, so that `await_answer` waits for a new key."""
        self._answer = ""

    def await_answer(self) -> str:
        """Wait for the person's answer after a trial, GO_ON, AGAIN or LEAVE, and return it.

        The answer is LEAVE if the trial ended for another reason.
        """
        while not self._answer and not self._has_ended():
            time.sleep(WAIT_S)
        return self._answer or LEAVE

    def ask(self, time_s: float) -> float | None:
        """Return the direction that the person wants [rad]. None to stop.

        Before the first key, this waits for it, unless the trial ends for another reason.
        """
        while self._wish.direction is None and not (self._wish.stops or self._has_ended()):
            time.sleep(WAIT_S)
        return self._wish.answer

    @property
    def pauses(self) -> bool:
        """Whether the person has asked for a pause, and no stop or end of the trial came since."""
        return self._wish.pauses and not (self._wish.stops or self._has_ended())

    def await_end_of_pause(self, show: Callable[[float], None]) -> None:
        """Wait until the person ends the pause or stops, or until the trial ends.

        `show` is called once for each new direction [rad] that the person tries meanwhile.
        """
        shown: float | None = None
        while self.pauses:
            direction = self._wish.direction
            if direction is not None and direction != shown:
                show(direction)
                shown = direction
            time.sleep(WAIT_S)

    def __enter__(self) -> Self:
        sys.stderr.write(MOUSE_ON)
        sys.stderr.flush()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()  # a thread that still asks must end
        sys.stderr.write(MOUSE_OFF)
        sys.stderr.flush()


def task(setup: Setup, disturbed: bool) -> str:
    """Describe to the person who steers what to do, and which robots turn fastest and slowest."""
    by_rate = [setup.names[robot] for robot in np.argsort(-setup.a)]
    rates = f" ({by_rate[0]} fastest, {by_rate[-1]} slowest)" if len(by_rate) > 1 else ""
    dots = "about where that leads" if disturbed else "where that leads"
    round_what = f", round the yellow {pluralize('obstacle', len(setup.obstacles))}"
    return (
        "Press an arrow: all robots turn to it while they drive, each at its own "
        f"rate{rates}. Dots: {dots}. Bring each robot to the square of its "
        f"colour{(round_what if setup.obstacles else '')}: total error 0. SPACE ends your "
        "try; then the controller can try."
    )


class KeyScript:
    """The keys in a file that steers in place of a person, each with its time [s].

    Times count from the first key.
    """

    def __init__(self, keys: list[tuple[float, str]]) -> None:
        self._keys = keys

    def ask(self, time_s: float) -> float | None:
        """Return the direction [rad] at a time after the first key [s]. None after a stop key."""
        wish = Wish()
        for pressed_s, key in self._keys:
            if pressed_s <= time_s:
                wish = wish.after(key)
        return wish.answer


def read_script(path: Path) -> KeyScript:
    """Read a file of keys that steers instead of a person.

    Raises:
        UsageError: With file and line, if a line is wrong, times decrease, or the first key is
            not an arrow.
    """
    keys: list[tuple[float, str]] = []
    last_s = 0.0
    text = read_text(path, expected="keys are lines of text").removeprefix(BYTE_ORDER_MARK)
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        where = f"{path}:{number}"
        if len(words) != 2:
            raise UsageError(
                f"{where}: the line must have the form SECONDS KEY", "for example `2.5 up`"
            )
        time_s = _seconds(words[0], where)
        if time_s < last_s:
            raise UsageError(
                f"{where}: the time {words[0]} s is before the previous line's {last_s:g} s"
            )
        last_s = time_s
        if words[1] not in ARROWS | dict.fromkeys(STOPS):
            raise UsageError(
                f"{where}: there is no key '{words[1]}'",
                "the keys are up, down, left, right, space",
            )
        keys.append((time_s, words[1]))
    first_s, first_key = keys[0] if keys else (0.0, "")
    if first_key not in ARROWS:
        raise UsageError(
            f"{path}: the script steers no robot", "start with an arrow key, such as `0 right`"
        )
    return KeyScript([(time_s - first_s, key) for time_s, key in keys])


def _seconds(word: str, where: str) -> float:
    """Convert a word of a file of keys to a time [s].

    Raises:
        UsageError: If it is no number, negative or infinite. The message starts with `where`.
    """
    try:
        time_s = float(word)
    except ValueError:
        time_s = math.nan
    if not 0 <= time_s < math.inf:
        raise UsageError(f"{where}: '{word}' is not a time in seconds")
    return time_s
