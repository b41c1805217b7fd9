"""The dashboard: a view of one instant of a trial that fills the terminal.

The library rich prints the dashboard, which has this layout:

    +--------------+  heading and time
    |              |  distance of each robot
    |    arena     |  total error            the numbers: blocks of lines, of which the
    |              |  plan                   least important are left out if space is short
    |              |  effort
    +--------------+  warnings and the end
    events, the newest at the bottom
    footer: the progress of the trial, and what the keys do

`live_screen` shows the dashboard of running trials, and `replay_screen` shows the dashboard of
logs. Widths and heights are in columns and lines of the terminal.
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
from tetractl.view.plan_words import describe_activity
from tetractl.view.player import Moment
from tetractl.view.terminal.arena import Projection, add_frame, draw_moment
from tetractl.view.terminal.glyphs import choose_arrow, draw_bar, draw_sparkline

SEARCH_ENDINGS: Mapping[str, str] = {
    StopReason.CRITERION: "by its criterion",
    StopReason.ITERATIONS: "at this limit",
    StopReason.TARGET: "good enough",
    StopReason.EVALUATIONS: "out of evaluations",
    StopReason.DEADLINE: "out of time",
}
"""Text that tells why the search for a plan ended, by the reason."""
LEVEL_STYLES = {"info": "", "warning": "yellow", "error": "bold red"}
"""Style of an event by its level."""
ARENA_FRACTION = 0.58
"""Fraction of the terminal's width that the arena can take.

The arena can take more if the numbers still have NUMBERS_WIDTH_WANTED columns.
"""
NUMBERS_WIDTH_WANTED = 36
"""Width of the numbers above which a wide arena can take more than ARENA_FRACTION [columns]."""
NUMBERS_WIDTH_MIN = 19
"""Minimum width that the arena leaves to the numbers [columns]."""
NUMBERS_WIDTH_MAX = 58
"""Maximum width of the numbers [columns]."""
GAP = 2
"""Number of empty columns between arena and numbers, and between hints."""
BAR_WIDTH_MAX = 60
"""Maximum width of the progress bar in the footer [columns]."""
BAR_WIDTH_WANTED = 12
"""Width that hints leave to the progress bar in the footer [columns]."""
ROBOT_BAR_WIDTH_MAX = 40
"""Maximum width of the bar that shows a robot's distance [columns]."""
ROBOT_LINES_MIN = 3
"""Minimum number of lines about robots, even if other blocks then have no line."""
FULL_BAR_MIN = 1e-12
"""Minimum distance that a full bar stands for [length unit].

Robots can start on their targets, and a bar cannot stand for 0.
"""
SPARKLINE_WIDTH_MAX = 48
"""Maximum width of a sparkline [columns]."""
OTHER_LINES = 12
"""Number of lines that the block of robots leaves to other blocks."""
EVENT_LINES_BY_HEIGHT = ((36, 6), (24, 2), (16, 1))
"""Pairs of a minimum height of the terminal and the number of events that it then shows.

The first pair whose height fits applies.
"""


@dataclass(frozen=True, slots=True)
class Footer:
    """The lowest line of the dashboard: a progress bar between two texts, and hints about keys.

    Attributes:
        left_text: Text to the left of the bar.
        fraction: Fraction of the bar that is filled, from 0 to 1.
        right_text: Text to the right of the bar.
        hints: Hints of the form "KEY ACTION", the most useful first. As many are shown as fit.
    """

    left_text: str
    fraction: float
    right_text: str
    hints: tuple[str, ...] = ()

    def render(self, width: int) -> Text:
        """Create the line for a width in characters.

        If the line is too long, hints are left out from the last one, then the bar is shortened.
        """
        text_width = len(self.left_text) + len(self.right_text) + 2
        hints = list(self.hints)
        while hints and text_width + BAR_WIDTH_WANTED + _width_of_hints(hints) > width:
            hints.pop()
        bar_width = max(width - text_width - _width_of_hints(hints), 0)
        progress_bar = draw_bar(min(bar_width, BAR_WIDTH_MAX), self.fraction, "bold")
        line = Text.assemble(f"{self.left_text} ", progress_bar, f" {self.right_text}")
        for hint in hints:
            key, _, action = hint.partition(" ")
            line.append_text(Text.assemble(" " * GAP, (key, "bold"), (f" {action}", "dim")))
        return line


def _width_of_hints(hints: list[str]) -> int:
    return sum(len(hint) + GAP for hint in hints)


def _is_given(step: Step) -> bool:
    """Check whether robots follow a direction from the spec in a step, without any search."""
    return not step.plan.pauses and step.plan.search.stopped == StopReason.FIXED


class Dashboard:
    """A view of a trial at one instant, which uses all the space available.

    Args:
        moment: The state of the trial at the instant.
        heading: The name of the trial.
        footer: The line at the bottom.
        notes: Warnings, for example about a damaged log.
        side_text: Text below the notes.
        steered_by_hand: Whether a person steers by hand. The view then leaves out the numbers of
            the step and its search, and events that are no warnings. It shows how the trial ended
            only if the trial was cut short; otherwise, `side_text` contains this.
    """

    def __init__(
        self,
        moment: Moment,
        heading: str,
        footer: Footer,
        notes: tuple[str, ...] = (),
        side_text: str = "",
        steered_by_hand: bool = False,
    ) -> None:
        self._moment = moment
        self._colors = robot_colors(moment.setup.names, moment.setup.colors)
        self._heading = heading
        self._footer = footer
        self._notes = notes
        self._side_text = side_text
        self._steered_by_hand = steered_by_hand

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = options.max_width
        height = options.height or console.height
        events = self._event_lines(height)
        footer = self._footer.render(width)
        body_height = max(height - 1 - len(events), 1)

        rows = self._arena_rows(width, body_height)
        arena_width = Segment.get_line_length(rows[0])
        numbers_width = min(width - arena_width - GAP, NUMBERS_WIDTH_MAX)
        if numbers_width > 0:
            numbers = self._number_lines(numbers_width, body_height)
            for row, line in zip(rows, numbers, strict=False):
                row += [Segment(" " * GAP), *fit_line(console, line, numbers_width)]
        rows += [fit_line(console, event, width) for event in events]
        rows.append(fit_line(console, footer, width))
        yield from fill_rows(rows, width)

    def _arena_rows(self, width: int, height: int) -> list[list[Segment]]:
        """Draw the arena with its border as exactly `height` rows of equal width.

        Blank rows follow below the border.
        """
        arena = self._moment.setup.arena
        left_by_share = width - GAP - round(ARENA_FRACTION * width)
        numbers_width = min(max(left_by_share, NUMBERS_WIDTH_MIN), NUMBERS_WIDTH_WANTED)
        arena_width = max(width - GAP - numbers_width, 3)  # a frame, and a column inside
        projection = Projection.fit(arena, arena_width - 2, height - 2)
        canvas = draw_moment(self._moment, self._colors, projection.width, projection.height)
        size_text = f"{arena.width:g} × {arena.height:g} {self._moment.setup.unit}"
        rows = list(add_frame(canvas, size_text))
        blank = Segment(" " * (projection.width + 2))
        while len(rows) < height:
            rows.append([blank])
        return rows[:height]

    def _number_lines(self, width: int, height: int) -> list[Text]:
        """Compose the numbers of the trial in at most `height` lines.

        If space is short, the least important blocks are left out. If lines remain, empty lines
        separate the blocks.
        """
        lines_by_rank = {  # from top to bottom; the highest rank is left out first
            0: self._head_lines(),
            3: self._robots_block(width, height),
            2: self._total_lines(width),
            4: self._plan_lines(width),
            5: self._effort_lines(),
            1: self._warnings_and_end(width),
        }
        blocks = {rank: block for rank, block in lines_by_rank.items() if block}
        while sum(map(len, blocks.values())) > height and len(blocks) > 1:
            del blocks[max(blocks)]
        spare_lines = height - sum(map(len, blocks.values()))
        lines: list[Text] = []
        for index, block in enumerate(blocks.values()):
            if lines and spare_lines >= len(blocks) - index:  # enough for each gap that follows
                lines.append(Text())
                spare_lines -= 1
            lines += block
        return lines[:height]

    def _head_lines(self) -> list[Text]:
        """Compose the lines with the trial's name, the time, the control step and the direction."""
        moment = self._moment
        step = moment.step
        end_text = "" if moment.end_s is None else f" / {moment.end_s:.1f}"
        lines = [
            Text(self._heading, "bold", no_wrap=True),
            _labelled_line("time", f"{moment.time_s:.1f}{end_text} s"),
        ]
        if not self._steered_by_hand:
            step_number = "none yet" if step is None else f"{step.k}"
            lines.append(_labelled_line("step k", step_number))
        if step is None:
            return lines
        if not (self._steered_by_hand or step.plan.pauses or _is_given(step)):
            count = len(step.plan.signals)
            signals = "1 signal" if count == 1 else f"{count} signals"
            lines.append(_labelled_line("horizon", signals))
        direction = step.command.direction
        if direction is None:
            activity = describe_activity(step.plan)
            is_searching = moment.result is None and step.plan.state is not State.STUCK
            if is_searching and step.plan.pauses:
                activity += ", searching"
            lines.append(_labelled_line("robots", activity))
        else:
            degrees = math.degrees(math.remainder(direction, math.tau))
            lines.append(_labelled_line("direction", f"{choose_arrow(direction)} {degrees:+.0f}°"))
        return lines

    def _robots_block(self, width: int, height: int) -> list[Text]:
        """Compose a title, then a line for each robot: its distance to its target, with a bar.

        If not all robots fit, a last line counts the other robots.
        """
        setup = self._moment.setup
        distances = self._moment.distances
        lines_max = max(height - OTHER_LINES, ROBOT_LINES_MIN)
        listed_count = len(distances) if len(distances) <= lines_max else lines_max - 1
        title = f"to target [{setup.unit}]"
        if not self._steered_by_hand:
            title += f", {self._moment.pose_kind}"
        lines = [Text(title, "dim", no_wrap=True)]
        lines += self._robot_lines(width, listed_count)
        if listed_count < len(distances):
            farthest = _format_length(float(distances[listed_count:].max()))
            lines.append(
                Text(f"and {len(distances) - listed_count} more, at most {farthest}", "dim")
            )
        return lines

    def _robot_lines(self, width: int, count: int) -> Iterator[Text]:
        """Yield a line for each of the first `count` robots: `ARROW NAME DISTANCE BAR`.

        If space is short, bars are left out first, and then names are cut. A full bar stands for
        the maximum distance at the start, which has four digits, for example 854.0.
        """
        setup = self._moment.setup
        distances = self._moment.distances[:count]
        names = setup.names[:count]
        start_distances = setup.distances(setup.starts.xy)
        full_distance = max(float(np.nanmax(start_distances)), FULL_BAR_MIN)
        digits = math.floor(math.log10(full_distance)) + 1  # before the decimal point
        decimals = min(max(4 - digits, 0), 6)
        value_width = max(
            len(f"{distance:.{decimals}f}") for distance in (full_distance, *distances)
        )
        remaining_width = width - value_width - 5  # the mark, three gaps, and a column to spare
        longest_name = max((len(name) for name in names), default=0)
        name_width = min(longest_name, max(remaining_width, 0))
        bar_width = min(max(remaining_width - name_width, 0), ROBOT_BAR_WIDTH_MAX)
        stationary_names = self._names_of_standing()
        for robot, (name, color) in enumerate(zip(names, self._colors, strict=False)):
            heading = self._moment.poses[robot, 2]
            distance = float(distances[robot])
            line = Text.assemble(
                (choose_arrow(heading), f"bold {color}"),
                (f" {name[:name_width]:<{name_width}} ", color),
                f"{distance:{value_width}.{decimals}f} ",
            )
            if name in stationary_names:
                line.append("stands", "yellow")
            else:
                line.append_text(draw_bar(bar_width, distance / full_distance, color))
            yield line

    def _names_of_standing(self) -> list[str]:
        """List the robots that stand still according to the controller's newest estimate.

        The list is empty if there is no estimate.
        """
        step = self._moment.step
        if step is None or not step.plan.estimate:
            return []
        return step.plan.estimate.list_standing(self._moment.setup.names)

    def _total_lines(self, width: int) -> list[Text]:
        """Compose a line with the total error, and a sparkline of the error at each step so far."""
        moment = self._moment
        total_error = _format_length(float(moment.distances.sum()))
        line_width = min(width, SPARKLINE_WIDTH_MAX)
        return [
            _labelled_line("total error", f"{total_error} {moment.setup.unit}"),
            draw_sparkline(moment.totals, line_width, total=moment.steps_total),
        ]

    def _plan_lines(self, width: int) -> list[Text]:
        """Compose lines with the cost of the newest plan before and after its search.

        A last line has the number of iterations. There are no lines if there was no search, if the
        robots pause, or if a person steers by hand.
        """
        setup = self._moment.setup
        step = self._moment.step
        if step is None or step.plan.pauses:
            return []  # robots that stand follow no plan
        if self._steered_by_hand or _is_given(step):
            return []
        search = step.plan.search
        iterations = len(search.history) - 1
        iterations_max = max(setup.iterations_max, iterations)
        first_cost = _format_length(float(search.history[0])) if iterations >= 0 else "?"
        last_cost = _format_length(step.plan.cost)
        reason = SEARCH_ENDINGS.get(search.stopped, search.stopped)
        line_width = min(width, SPARKLINE_WIDTH_MAX)
        return [
            _labelled_line("plan cost J", f"{first_cost} → {last_cost} {setup.unit}"),
            draw_sparkline(search.history, line_width, total=iterations_max + 1, log=True),
            _labelled_line("iterations", f"{iterations} of {iterations_max}, {reason}"),
        ]

    def _effort_lines(self) -> list[Text]:
        """Compose lines with the duration of the newest search, and its number of evaluations.

        There are no lines if there was no search, or if a person steers by hand.
        """
        step = self._moment.step
        if step is None or self._steered_by_hand or _is_given(step):
            return []
        solve_line = _labelled_line("solve time", f"{milliseconds(step.solve_ns):.1f} ms")
        if step.deadline_missed:
            solve_line.append("  too late", "bold red")
        evaluations = f"{step.plan.evaluations:,}".replace(",", " ")
        return [solve_line, _labelled_line("evaluations", evaluations)]

    def _warnings_and_end(self, width: int) -> list[Text]:
        """Compose lines with the warnings, `side_text` and, once there is a result, the result.

        If a person steers by hand, a complete trial has no lines about its result.
        """
        lines = [Text(note, "bold red", no_wrap=True) for note in self._notes]
        aside = textwrap.wrap(self._side_text, width, break_on_hyphens=False)  # links stay whole
        lines += [Text(line, "dim", no_wrap=True) for line in aside]
        result = self._moment.result
        if result is not None and not (self._steered_by_hand and result.outcome.complete):
            lines += _end_lines(result, width)
        return lines

    def _event_lines(self, height: int) -> list[Text]:
        """Compose lines with the newest events, as many as a terminal of `height` lines shows.

        Empty lines above the events keep space for later events. Before the first event, there are
        no lines.
        """
        events = [
            note
            for note in self._moment.events
            if note.level != "info" or not self._steered_by_hand
        ]
        if not events:
            return []
        shown_max = next(
            (count for height_min, count in EVENT_LINES_BY_HEIGHT if height >= height_min), 0
        )
        hidden = max(len(events) - shown_max, 0)
        lines = []
        for event in events[hidden:]:
            event_text = event.text if event.level == "info" else f"{event.level}: {event.text}"
            timestamp = (f"{event.time_s:7.1f} s  ", "dim")
            style = LEVEL_STYLES.get(event.level, "")
            lines.append(Text.assemble(timestamp, event_text, style=style, no_wrap=True))
        empty_lines = [Text() for _ in range(shown_max - len(lines))]
        return empty_lines + lines


def fit_line(console: Console, text: Text, width: int) -> list[Segment]:
    """Cut a line of text to a width, and return it as segments.

    If the text is cut, it ends with an ellipsis, so that no number looks like a shorter one.

    Args:
        console: The console.
        text: The line.
        width: Maximum width.
    """
    text.no_wrap = True
    text.truncate(width, overflow="ellipsis")
    return list(text.render(console))


def fill_rows(rows: Sequence[list[Segment]], width: int) -> RenderResult:
    """Yield the segments of rows, each cut or filled to exactly `width` characters."""
    for number, row in enumerate(rows):
        if number:
            yield Segment.line()
        yield from Segment.adjust_line_length(row, width)


def _end_lines(result: Result, width: int) -> list[Text]:
    """Compose lines that describe how a trial ended, and why, wrapped to `width` characters."""
    alarm = "bold red" if result.outcome is Outcome.ABORTED else ""
    lines = [Text(f"ended: {result.outcome}", "bold", no_wrap=True)]
    lines += [Text(line, alarm, no_wrap=True) for line in textwrap.wrap(result.reason, width)]
    if result.entered_obstacle:
        lines.append(Text("a robot entered an obstacle", "bold red"))
    return lines


def _labelled_line(label: str, value: str) -> Text:
    """Format a line of the dashboard that consists of a label and a value."""
    return Text.assemble((f"{label:<11} ", "dim"), value, no_wrap=True)


def _format_length(value: float) -> str:
    """Format a length for the dashboard.

    A length of 100 or more has no decimals, a length of 1 or more has one decimal, and a smaller
    length has three significant digits.
    """
    if not math.isfinite(value):
        return str(value)
    magnitude = abs(value)
    if magnitude >= 100:
        return f"{value:.0f}"
    if magnitude >= 1:
        return f"{value:.1f}"
    return f"{value:.3g}"
