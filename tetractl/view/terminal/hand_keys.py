"""Steering by hand: reads the direction that a person chooses with keys, a mouse or a file.

    arrows        the robots turn to the right, up, to the left, down
    the mouse     drag anywhere: the robots turn to the direction of the drag
    p             pause a simulation, and show where each arrow leads; p again continues
    space, q      stop the robots, which ends the trial

A file has a line `SECONDS KEY` for each key. A `#` starts a comment. The first key starts the
robots, and times count from the first key.
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
"""The direction of each arrow key [rad]."""
STOP_KEYS = {"space", "q"}
PAUSE_KEY = "p"
HINTS = ("arrows steer", "SPACE ends", "P: pause", "mouse: drag")
"""What the keys do in a simulation, the most important first."""
LAB_HINTS = ("ESC: EMERGENCY STOP", "arrows steer", "SPACE ends", "mouse: drag")
"""What the keys do in a lab, the most important first."""
CONTINUE_KEY = "enter"
REPEAT_KEY = "r"
QUIT_KEY = "q"
"""Keys that answer the question how to continue after a trial.

No arrow key is an answer, because the person may still press arrows when the trial ends.
"""
WHY_HARD_TEXT = (
    "All robots received the same directions, but each turns at its own rate, so every turn "
    "changes the gaps between them. The right turns in the right order bring each robot "
    "home. This is hard because no robot can be moved alone: what brings one home takes "
    "others away."
)
"""Text that explains, after a trial, why steering by hand is hard.

It takes eight lines of the smallest panel.
"""
PAUSED_TEXT = "PAUSED. Try arrows: dots show where each leads. Nothing moves until you press P."
"""Text shown during a pause."""
BYTE_ORDER_MARK = "\ufeff"
"""Character that some editors write at the beginning of a file."""
CHECK_INTERVAL_S = 0.01
"""Time between two checks whether a key has been pressed [s]."""
CELL_HEIGHT = 2.0
"""Height of a character cell of a terminal, relative to its width."""
_MOUSE = re.compile(r"<(?P<button>\d+);(?P<column>\d+);(?P<row>\d+)(?P<kind>[Mm])")
"""A mouse event as a terminal sends it in mode 1006, without the escape character."""
PRESSED_BUTTON = 0
DRAGGED_BUTTON = 32
"""Button number of a mouse event while the mouse moves with the left button pressed.

PRESSED_BUTTON is its number at the moment when it is pressed.
"""
MOUSE_ON_SEQUENCE = "\x1b[?1002h\x1b[?1006h"
MOUSE_OFF_SEQUENCE = "\x1b[?1006l\x1b[?1002l"


@dataclass(frozen=True, slots=True)
class SteeringWish:
    """The present wish of the person who steers: a direction, a stop, or a pause.

    Attributes:
        direction: The direction [rad]. None before the first key.
        stops: Whether to stop.
        pauses: Whether to pause.
        drag_start: Column and row of the screen at which a drag of the mouse began. None without a
            drag.
    """

    direction: float | None = None
    stops: bool = False
    pauses: bool = False
    drag_start: tuple[int, int] | None = None

    @property
    def direction_or_stop(self) -> float | None:
        """The direction that the person wants [rad]. None for a stop, or before the first key."""
        return None if self.stops else self.direction

    def after_key(self, key: str) -> "SteeringWish":
        """Return the person's new wish after a key or a mouse event.

        Keys without a function do not change the wish. A stop cannot be taken back.
        """
        if key in ARROWS:
            return replace(self, direction=ARROWS[key])
        if key in STOP_KEYS:
            return replace(self, stops=True)
        if key == PAUSE_KEY and self.direction is not None:
            return replace(self, pauses=not self.pauses)
        mouse = _MOUSE.fullmatch(key)
        return self if mouse is None else self._after_drag(mouse)

    def _after_drag(self, mouse: re.Match[str]) -> "SteeringWish":
        column = int(mouse["column"])
        row = int(mouse["row"])
        button = int(mouse["button"])
        if button == PRESSED_BUTTON and mouse["kind"] == "M":
            return replace(self, drag_start=(column, row))
        if button != DRAGGED_BUTTON or self.drag_start is None or self.drag_start == (column, row):
            return self
        columns_right = column - self.drag_start[0]
        columns_up = CELL_HEIGHT * (self.drag_start[1] - row)
        return replace(self, direction=math.atan2(columns_up, columns_right))


class HandKeys:
    """Reader of a person's wishes from keys and mouse of a terminal; a context manager.

    Only a simulation `can_pause`. Two threads use this object. The thread of the keys calls
    `press`, and replaces the wish as a whole. The thread of the trial calls `ask`, which reads it.
    The same holds for the answer and `await_answer`.
    """

    def __init__(self, has_ended: Callable[[], bool], can_pause: bool = False) -> None:
        self._wish = SteeringWish()
        self._answer = ""
        self._has_ended = has_ended
        self._can_pause = can_pause

    def press(self, key: str) -> None:
        """Change the person's wish according to a pressed key, given by its name.

        The key may also be the answer for which `await_answer` waits. The pause key is ignored if
        the plant cannot pause.
        """
        name = key.lower() if len(key) == 1 else key  # P is p
        if name != PAUSE_KEY or self._can_pause:
            self._wish = self._wish.after_key(name)
        if name in (CONTINUE_KEY, REPEAT_KEY, QUIT_KEY):
            self._answer = name

    def stop(self) -> None:
        """Stop the robots, as the space bar does, and answer QUIT_KEY."""
        self._wish = replace(self._wish, stops=True)
        self._answer = QUIT_KEY

    def forget_answer(self) -> None:
        """Forget earlier answers, so that `await_answer` waits for a new key."""
        self._answer = ""

    def await_answer(self) -> str:
        """Wait until the person presses CONTINUE_KEY, REPEAT_KEY or QUIT_KEY, and return the key.

        The result is QUIT_KEY if the trial ended for another reason.
        """
        while not self._answer and not self._has_ended():
            time.sleep(CHECK_INTERVAL_S)
        return self._answer or QUIT_KEY

    def ask(self, time_s: float) -> float | None:
        """Return the direction that the person wants [rad]. None to stop.

        Before the first key, this function waits for the key, unless the trial ends for another
        reason.
        """
        while self._wish.direction is None and not (self._wish.stops or self._has_ended()):
            time.sleep(CHECK_INTERVAL_S)
        return self._wish.direction_or_stop

    @property
    def pauses(self) -> bool:
        """Whether the trial is paused: the person has asked for a pause, and it has not ended."""
        return self._wish.pauses and not (self._wish.stops or self._has_ended())

    def await_end_of_pause(self, show: Callable[[float], None]) -> None:
        """Wait until the person ends the pause or stops, or until the trial ends.

        `show` is called once for each new direction [rad] that the person tries meanwhile.
        """
        shown_direction: float | None = None
        while self.pauses:
            direction = self._wish.direction
            if direction is not None and direction != shown_direction:
                show(direction)
                shown_direction = direction
            time.sleep(CHECK_INTERVAL_S)

    def __enter__(self) -> Self:
        sys.stderr.write(MOUSE_ON_SEQUENCE)
        sys.stderr.flush()
        return self

    def __exit__(self, *error: object) -> None:
        self.stop()  # a thread that still asks must end
        sys.stderr.write(MOUSE_OFF_SEQUENCE)
        sys.stderr.flush()


def describe_task(setup: Setup, disturbed: bool) -> str:
    """Describe the task of the person who steers, and which robots turn fastest and slowest."""
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
    """A list of timed keys from a file, which steers instead of a person.

    The times [s] count from the first key.
    """

    def __init__(self, keys: list[tuple[float, str]]) -> None:
        self._keys = keys

    def ask(self, time_s: float) -> float | None:
        """Return the direction [rad] at a time after the first key [s]. None after a stop key."""
        wish = SteeringWish()
        for pressed_s, key in self._keys:
            if pressed_s <= time_s:
                wish = wish.after_key(key)
        return wish.direction_or_stop


def read_key_script(path: Path) -> KeyScript:
    """Read a file of timed keys that steers instead of a person.

    Raises:
        UsageError: If a line is wrong, if times decrease, or if the first key is not an arrow. The
            message names the file and the line.
    """
    keys: list[tuple[float, str]] = []
    last_s = 0.0
    text = read_text(path, expected="keys are lines of text").removeprefix(BYTE_ORDER_MARK)
    for line_number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].split()
        if not words:
            continue
        location = f"{path}:{line_number}"
        if len(words) != 2:
            raise UsageError(
                f"{location}: the line must have the form SECONDS KEY", "for example `2.5 up`"
            )
        time_s = _parse_seconds(words[0], location)
        if time_s < last_s:
            raise UsageError(
                f"{location}: the time {words[0]} s is before the previous line's {last_s:g} s"
            )
        last_s = time_s
        if words[1] not in ARROWS | dict.fromkeys(STOP_KEYS):
            raise UsageError(
                f"{location}: there is no key '{words[1]}'",
                "the keys are up, down, left, right, space",
            )
        keys.append((time_s, words[1]))
    first_s, first_key = keys[0] if keys else (0.0, "")
    if first_key not in ARROWS:
        raise UsageError(
            f"{path}: the script steers no robot", "start with an arrow key, such as `0 right`"
        )
    return KeyScript([(time_s - first_s, key) for time_s, key in keys])


def _parse_seconds(text: str, location: str) -> float:
    """Convert a word in a file of keys to a time [s].

    Raises:
        UsageError: If the word is not a number, or if the time is negative or infinite. The message
            starts with `location`.
    """
    try:
        time_s = float(text)
    except ValueError:
        time_s = math.nan
    if not 0 <= time_s < math.inf:
        raise UsageError(f"{location}: '{text}' is not a time in seconds")
    return time_s
