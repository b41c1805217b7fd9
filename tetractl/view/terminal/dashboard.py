"""The dashboard: a view of one instant of a trial that fills the terminal, printed by rich.

    +--------------+  heading and time
    |              |  distance of each robot
    |    arena     |  total error            the numbers: blocks of lines, of which the
    |              |  plan                   least important are left out if space is short
    |              |  effort
    +--------------+  warnings and the end
    events, the newest at the bottom
    footer: what the keys do, and how far it is

`live_screen` shows the dashboard of running trials, and `replay_screen` that of logs. Widths and
heights are in columns and lines of the terminal.
"""

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from rich.console import Console, ConsoleOptions, RenderResult
from rich.segment import Segment
from rich.text import Text

from tetractl.core.clock import milliseconds
from tetractl.core.colors import robot_colors
from tetractl.core.plan import Outcome, State, StopReason
from tetractl.core.trial import Result, Step
from tetractl.view.plan_words import doing
from tetractl.view.player import Moment
from tetractl.view.terminal.arena import Projection, draw, framed
from tetractl.view.terminal.glyphs import arrow, bar, sparkline

ENDED: Mapping[str, str] = {
    StopReason.CRITERION: "by its criterion",
    StopReason.ITERATIONS: "at this limit",
    StopReason.TARGET: "good enough",
    StopReason.EVALUATIONS: "out of evaluations",
    StopReason.DEADLINE: "out of time",
}
"""Why the search of the newest plan ended, after the number of its iterations."""
LEVEL_STYLES = {"info": "", "warning": "yellow", "error": "bold red"}
"""Style of an event by its level."""
ARENA_SHARE = 0.58
"""Fraction of the width that the arena may take.

It may take more if the numbers still have NUMBERS_WANTED columns.
"""
NUMBERS_WANTED = 36
NUMBERS_LEAST = 19
"""Minimum width that the arena leaves to the numbers [columns]."""
NUMBERS_MOST = 58
GAP = 2
"""Number of columns between arena and numbers, and between hints."""
BAR_MOST = 60
BAR_WANTED = 12
"""Width that hints leave to the footer's bar [columns]. BAR_MOST is its maximum width."""
ROBOT_BAR_MOST = 40
ROBOTS_LEAST = 3
"""Minimum number of lines of robots, even if other blocks then have no line."""
SMALLEST = 1e-12
"""Minimum distance of a full bar [length unit], because robots may start on their targets."""
SPARKLINE_MOST = 48
LINES_OF_OTHERS = 12
"""Number of lines that the robots' block leaves to other blocks."""
EVENTS_SHOWN = ((36, 6), (24, 2), (16, 1))
"""Minimum height of the terminal, and how many events it then shows; the first that fits."""


@dataclass(frozen=True, slots=True)
class Footer:
    """The lowest line of the dashboard: a progress bar between two texts, and hints about keys.

    `before` is the text before the bar, and `after` the text behind it. As many `hints` are shown
    as fit.
    """

    before: str
    fraction: float
    after: str
    hints: tuple[str, ...] = ()

    def text(self, width: int) -> Text:
        """Return the line for a width in characters.

        If it is too long, hints are left out from the last one, then the bar is shortened.
        """
        words = len(self.before) + len(self.after) + 2
        hints = list(self.hints)
        while hints and words + BAR_WANTED + _width_of_hints(hints) > width:
            hints.pop()
        bar_width = max(width - words - _width_of_hints(hints), 0)
        filled = bar(min(bar_width, BAR_MOST), self.fraction, "bold")
        line = Text.assemble(f"{self.before} ", filled, f" {self.after}")
        for hint in hints:
            key, _, action = hint.partition(" ")
            line.append_text(Text.assemble(" " * GAP, (key, "bold"), (f" {action}", "dim")))
        return line


def _width_of_hints(hints: list[str]) -> int:
    return sum(len(hint) + GAP for hint in hints)


def _is_given(step: Step) -> bool:
    """Check whether robots follow a given direction in a step, so that there was no search."""
    return not step.plan.pauses and step.plan.search.stopped == StopReason.FIXED


class Dashboard:
    """A view of a trial at one instant, which uses all the space available.

    Args:
        moment: The instant.
        heading: The name of the trial.
        footer: The lines at the bottom.
        notes: Warnings, for example about a damaged log.
        aside: Text below the notes.
        plain: Whether a person steers by hand. Then the numbers of the step and its search are left
            out, and so are events that are no warnings. How the trial ended is shown only if it was
            cut short; otherwise, `aside` says it.
    """

    def __init__(
        self,
        moment: Moment,
        heading: str,
        footer: Footer,
        notes: tuple[str, ...] = (),
        aside: str = "",
        plain: bool = False,
    ) -> None:
        self._moment = moment
        self._colors = robot_colors(moment.setup.names, moment.setup.colors)
        self._heading = heading
        self._footer = footer
        self._notes = notes
        self._aside = aside
        self._plain = plain

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = options.max_width
        height = options.height or console.height
        events = self._events(height)
        footer = self._footer.text(width)
        body_height = max(height - 1 - len(events), 1)

        rows = self._arena(width, body_height)
        arena_width = Segment.get_line_length(rows[0])
        numbers_width = min(width - arena_width - GAP, NUMBERS_MOST)
        if numbers_width > 0:
            numbers = self._numbers(numbers_width, body_height)
            for row, text in zip(rows, numbers, strict=False):
                row += [Segment(" " * GAP), *fitted(console, text, numbers_width)]
        rows += [fitted(console, event, width) for event in events]
        rows.append(fitted(console, footer, width))
        yield from printed(rows, width)

    def _arena(self, width: int, height: int) -> list[list[Segment]]:
        """Return the arena in its frame as exactly `height` rows of equal width.

        Rows of blanks fill the rest.
        """
        arena = self._moment.setup.arena
        left_by_share = width - GAP - round(ARENA_SHARE * width)
        numbers_width = min(max(left_by_share, NUMBERS_LEAST), NUMBERS_WANTED)
        arena_width = max(width - GAP - numbers_width, 3)  # a frame, and a column inside
        inside = Projection.fit(arena, arena_width - 2, height - 2)
        canvas = draw(self._moment, self._colors, inside.width, inside.height)
        size = f"{arena.width:g} × {arena.height:g} {self._moment.setup.unit}"
        rows = list(framed(canvas, size))
        blank = Segment(" " * (inside.width + 2))
        while len(rows) < height:
            rows.append([blank])
        return rows[:height]

    def _numbers(self, width: int, height: int) -> list[Text]:
        """Return the part with the trial's numbers, in at most `height` lines.

        The blocks that fit are shown, with an empty line between them as long as there are lines
        left.
        """
        by_rank = {  # from top to bottom; where space is short, the greatest rank goes first
            0: self._head(),
            3: self._robots(width, height),
            2: self._total(width),
            4: self._plan(width),
            5: self._effort(),
            1: self._warnings_and_end(width),
        }
        blocks = {rank: block for rank, block in by_rank.items() if block}
        while sum(map(len, blocks.values())) > height and len(blocks) > 1:
            del blocks[max(blocks)]
        spare = height - sum(map(len, blocks.values()))
        lines: list[Text] = []
        for index, block in enumerate(blocks.values()):
            if lines and spare >= len(blocks) - index:  # enough for each gap that follows
                lines.append(Text())
                spare -= 1
            lines += block
        return lines[:height]

    def _head(self) -> list[Text]:
        """Return lines that describe the trial, the time, the control step and the direction."""
        moment = self._moment
        step = moment.step
        until = "" if moment.end_s is None else f" / {moment.end_s:.1f}"
        lines = [
            Text(self._heading, "bold", no_wrap=True),
            _row("time", f"{moment.time_s:.1f}{until} s"),
        ]
        if not self._plain:
            number = "none yet" if step is None else f"{step.k}"
            lines.append(_row("step k", number))
        if step is None:
            return lines
        if not (self._plain or step.plan.pauses or _is_given(step)):
            count = len(step.plan.signals)
            signals = "1 signal" if count == 1 else f"{count} signals"
            lines.append(_row("horizon", signals))
        direction = step.command.direction
        if direction is None:
            robots = doing(step.plan)
            searches = moment.result is None and step.plan.state is not State.STUCK
            if searches and step.plan.pauses:
                robots += ", searching"
            lines.append(_row("robots", robots))
        else:
            degrees = math.degrees(math.remainder(direction, math.tau))
            lines.append(_row("direction", f"{arrow(direction)} {degrees:+.0f}°"))
        return lines

    def _robots(self, width: int, height: int) -> list[Text]:
        """Return a title, then a line for each robot: its distance to its target, with a bar.

        If not all robots fit, a line describes the others.
        """
        setup = self._moment.setup
        distances = self._moment.distances
        lines_most = max(height - LINES_OF_OTHERS, ROBOTS_LEAST)
        listed = len(distances) if len(distances) <= lines_most else lines_most - 1
        title = f"to target [{setup.unit}]"
        if not self._plain:
            title += f", {self._moment.known}"
        lines = [Text(title, "dim", no_wrap=True)]
        lines += self._robot_lines(width, listed)
        if listed < len(distances):
            worst = _number(float(distances[listed:].max()))
            lines.append(Text(f"and {len(distances) - listed} more, at most {worst}", "dim"))
        return lines

    def _robot_lines(self, width: int, count: int) -> Iterator[Text]:
        """Yield a line for each of the first robots: `MARK NAME VALUE BAR`.

        Names are cut before values are, and bars get what is left. A full bar is the maximum
        distance at the start, which has four digits: 854.0 mm.
        """
        setup = self._moment.setup
        distances = self._moment.distances[:count]
        names = setup.names[:count]
        at_start = setup.distances(setup.starts.xy)
        full = max(float(np.nanmax(at_start)), SMALLEST)
        digits = math.floor(math.log10(full)) + 1  # before the decimal point
        decimals = min(max(4 - digits, 0), 6)
        value_width = max(len(f"{distance:.{decimals}f}") for distance in (full, *distances))
        rest = width - value_width - 5  # the mark, three gaps, and a column to spare
        longest_name = max((len(name) for name in names), default=0)
        name_width = min(longest_name, max(rest, 0))
        bar_width = min(max(rest - name_width, 0), ROBOT_BAR_MOST)
        standing = self._standing()
        for robot, (name, color) in enumerate(zip(names, self._colors, strict=False)):
            heading = self._moment.poses[robot, 2]
            distance = float(distances[robot])
            line = Text.assemble(
                (arrow(heading), f"bold {color}"),
                (f" {name[:name_width]:<{name_width}} ", color),
                f"{distance:{value_width}.{decimals}f} ",
            )
            if name in standing:
                line.append("stands", "yellow")
            else:
                line.append_text(bar(bar_width, distance / full, color))
            yield line

    def _standing(self) -> list[str]:
        """Return the names of the robots that stand still, as estimated with the newest plan.

        Empty if there is no estimate.
        """
        step = self._moment.step
        if step is None or not step.plan.estimate:
            return []
        return step.plan.estimate.standing(self._moment.setup.names)

    def _total(self, width: int) -> list[Text]:
        """Return a line with the total error, and a small curve of it at each step so far."""
        moment = self._moment
        total = _number(float(moment.distances.sum()))
        line_width = min(width, SPARKLINE_MOST)
        return [
            _row("total error", f"{total} {moment.setup.unit}"),
            sparkline(moment.totals, line_width, total=moment.steps_end),
        ]

    def _plan(self, width: int) -> list[Text]:
        """Return lines with the cost of the newest plan before and after its search.

        They also state the search's iterations. Empty if there was no search, if the robots pause,
        or in the plain style.
        """
        setup = self._moment.setup
        step = self._moment.step
        if step is None or step.plan.pauses:
            return []  # robots that stand follow no plan
        if self._plain or _is_given(step):
            return []
        search = step.plan.search
        done = len(search.history) - 1
        most = max(setup.iterations_max, done)
        first = _number(float(search.history[0])) if done >= 0 else "?"
        last = _number(step.plan.cost)
        ended = ENDED.get(search.stopped, search.stopped)
        line_width = min(width, SPARKLINE_MOST)
        return [
            _row("plan cost J", f"{first} → {last} {setup.unit}"),
            sparkline(search.history, line_width, total=most + 1, log=True),
            _row("iterations", f"{done} of {most}, {ended}"),
        ]

    def _effort(self) -> list[Text]:
        """Return lines that state how long the newest search took, and how many evaluations.

        Empty if there was no search, or in the plain style.
        """
        step = self._moment.step
        if step is None or self._plain or _is_given(step):
            return []
        solve = _row("solve time", f"{milliseconds(step.solve_ns):.1f} ms")
        if step.deadline_missed:
            solve.append("  too late", "bold red")
        evaluations = f"{step.plan.evaluations:,}".replace(",", " ")
        return [solve, _row("evaluations", evaluations)]

    def _warnings_and_end(self, width: int) -> list[Text]:
        """Return the notes, the text `aside` and, once there is a result, lines about it.

        In the plain style, a complete trial has no lines about its result.
        """
        lines = [Text(note, "bold red", no_wrap=True) for note in self._notes]
        aside = textwrap.wrap(self._aside, width, break_on_hyphens=False)  # links stay whole
        lines += [Text(line, "dim", no_wrap=True) for line in aside]
        result = self._moment.result
        if result is not None and not (self._plain and result.outcome.complete):
            lines += _end_lines(result, width)
        return lines

    def _events(self, height: int) -> list[Text]:
        """Return the newest events, as many as a terminal of `height` lines shows.

        Above them are empty lines for future events. Before the first event, the result is empty.
        """
        events = [e for e in self._moment.events if e.level != "info" or not self._plain]
        if not events:
            return []
        most = next((count for least, count in EVENTS_SHOWN if height >= least), 0)
        older = max(len(events) - most, 0)
        lines = []
        for event in events[older:]:
            text = event.text if event.level == "info" else f"{event.level}: {event.text}"
            time = (f"{event.time_s:7.1f} s  ", "dim")
            style = LEVEL_STYLES.get(event.level, "")
            lines.append(Text.assemble(time, text, style=style, no_wrap=True))
        empty = [Text() for _ in range(most - len(lines))]
        return empty + lines


def fitted(console: Console, text: Text, width: int) -> list[Segment]:
    """Return a line of text as segments that fit a given width.

    If the text is cut, its last sign is an ellipsis, so that no number looks like a shorter one.

    Args:
        console: The console.
        text: The line.
        width: Maximum width.
    """
    text.no_wrap = True
    text.truncate(width, overflow="ellipsis")
    return list(text.render(console))


def printed(rows: Sequence[list[Segment]], width: int) -> RenderResult:
    """Yield rows for the library rich, each cut or filled to exactly `width` characters."""
    for number, row in enumerate(rows):
        if number:
            yield Segment.line()
        yield from Segment.adjust_line_length(row, width)


def _end_lines(result: Result, width: int) -> list[Text]:
    """Return lines that describe how a trial ended, and why, wrapped to `width` characters."""
    alarm = "bold red" if result.outcome is Outcome.ABORTED else ""
    lines = [Text(f"ended: {result.outcome}", "bold", no_wrap=True)]
    lines += [Text(line, alarm, no_wrap=True) for line in textwrap.wrap(result.reason, width)]
    if result.entered_obstacle:
        lines.append(Text("a robot entered an obstacle", "bold red"))
    return lines


def _row(label: str, value: str) -> Text:
    """Return a line of the dashboard, with a label and a value."""
    return Text.assemble((f"{label:<11} ", "dim"), value, no_wrap=True)


def _number(value: float) -> str:
    """Format a length for the dashboard.

    It has no decimals from 100 on, one decimal from 1 on, and three significant digits below 1.
    """
    if not math.isfinite(value):
        return str(value)
    size = abs(value)
    if size >= 100:
        return f"{value:.0f}"
    if size >= 1:
        return f"{value:.1f}"
    return f"{value:.3g}"
