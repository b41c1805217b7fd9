"""The dashboard: the arena on the left, numbers on the right, a line of controls below."""

import math
import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from rich.console import Console, ConsoleOptions, RenderResult
from rich.segment import Segment
from rich.text import Text

from tetractl.core.clock import milliseconds
from tetractl.core.plan import Outcome, Plan
from tetractl.replay.player import Moment
from tetractl.view.terminal.arena import Projection, draw, framed
from tetractl.view.terminal.glyphs import Glyphs, arrow, bar, glyphs_for, sparkline

LEVEL_STYLES = {"info": "", "warning": "yellow", "error": "bold red"}
COMPACT = 30  # width of the numbers below which labels are short [columns]


@dataclass(frozen=True, slots=True)
class Footer:
    """The lowest line: text on the left, a bar, text on the right, and the `hints` that fit."""

    left: str
    fraction: float
    right: str
    hints: tuple[str, ...] = ()

    def text(self, glyphs: Glyphs, width: int) -> Text:
        """Return the line; if it is too long, hints are left out, then the bar is shortened."""
        fixed = len(self.left) + len(self.right) + 2
        hints = list(self.hints)
        while hints and fixed + 12 + _length(hints) > width:
            hints.pop()
        room = max(width - fixed - _length(hints), 0)
        line = Text.assemble(
            f"{self.left} ", bar(glyphs, min(room, 60), self.fraction, "bold"), f" {self.right}"
        )
        for hint in hints:
            key, _, does = hint.partition(" ")
            line.append_text(Text.assemble("  ", (key, "bold"), (f" {does}", "dim")))
        return line


def fitted(
    console: Console, text: Text, width: int, overflow: Literal["crop", "ellipsis"] = "crop"
) -> list[Segment]:
    """Return a line of text as segments, cut at a width."""
    text.no_wrap = True
    text.truncate(width, overflow=overflow)
    return list(text.render(console))


def printed(rows: Sequence[list[Segment]], width: int) -> RenderResult:
    """Yield rows for rich, each exactly as wide as the screen."""
    for number, row in enumerate(rows):
        if number:
            yield Segment.line()
        yield from Segment.adjust_line_length(row, width)


def _length(hints: list[str]) -> int:
    return sum(len(hint) + 2 for hint in hints)


class Dashboard:
    """Shows a trial at one time, on all the space available; the library rich prints it.

    `heading` names the trial, `notes` are warnings such as a log's damage, and `aside` is text
    below the notes.
    """

    def __init__(
        self,
        frame: Moment,
        colors: list[str],
        heading: str,
        footer: Footer,
        notes: tuple[str, ...] = (),
        aside: str = "",
    ) -> None:
        self._frame, self._colors = frame, colors
        self._heading, self._footer = heading, footer
        self._notes, self._aside = notes, aside

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        glyphs = glyphs_for(console)
        width, height = options.max_width, (options.height or console.height)
        events = self._events(height)
        body = max(height - 1 - len(events), 1)
        arena, unit = self._frame.setup.arena, self._frame.setup.unit
        # the arena may take 58 % of the screen, and leaves the numbers 20 to 58 columns
        most = max(min(width - 21, max(round(0.58 * width), width - 38)), 3)
        view = Projection.fit(arena, most - 2, body - 2)
        canvas = draw(self._frame, self._colors, glyphs, view.width, view.height)
        label = f"{arena.width:g} {glyphs.times} {arena.height:g} {unit}"
        rows = [*framed(canvas, label, glyphs)]
        across = view.width + 2
        rows = [*rows, *([Segment(" " * across)] for _ in range(body - len(rows)))][:body]
        room = min(width - across - 2, 58)
        side = self.side(glyphs, room, body) if room >= 8 else []
        for row, text in zip(rows, side, strict=False):
            row += [Segment("  "), *fitted(console, text, room)]
        cut = "ellipsis" if not glyphs.ascii else "crop"
        rows += [fitted(console, event, width, cut) for event in events]
        yield from printed([*rows, fitted(console, self._footer.text(glyphs, width), width)], width)

    def side(self, glyphs: Glyphs, width: int, height: int) -> list[Text]:
        """Return the numbers in at most `height` lines; if these are too few, the least important
        blocks are left out.
        """
        blocks = [
            (0, self._head(glyphs, width)),
            (3, self._robots(glyphs, width, height)),
            (2, self._total(glyphs, width)),
            (4, self._plan(glyphs, width)),
            (5, self._effort(width)),
            (1, self._last(width)),
        ]
        blocks = [(rank, lines) for rank, lines in blocks if lines]
        while sum(len(lines) for _, lines in blocks) > height and len(blocks) > 1:
            blocks.remove(max(blocks, key=lambda block: block[0]))
        spare = height - sum(len(lines) for _, lines in blocks)
        laid: list[Text] = []
        for index, (_, lines) in enumerate(blocks):
            if laid and spare >= len(blocks) - index:
                laid.append(Text())
                spare -= 1
            laid += lines
        return laid[:height]

    def _head(self, glyphs: Glyphs, width: int) -> list[Text]:
        frame, step = self._frame, self._frame.step
        end = "" if frame.end_s is None else f" / {frame.end_s:.1f}"
        lines = [
            Text(_fitting(width, *_shortened(self._heading)), "bold", no_wrap=True),
            _row(width, "time", "t", f"{frame.time_s:.1f}{end} s"),
        ]
        if step is None:
            return [*lines, _row(width, "step k", "k", "none yet")]
        lines.append(_row(width, "step k", "k", f"{step.k}"))
        signals = len(step.plan.signals)
        if not step.plan.pauses:
            lines.append(_row(width, "horizon", "h", f"{signals} signal{'s' * (signals != 1)}"))
        u = step.command.direction
        if u is None:
            return [*lines, _row(width, "robots", "do", step.plan.doing)]
        degrees = math.degrees(math.remainder(u, math.tau))
        sign = f"{arrow(glyphs, u)} {degrees:+.0f}{glyphs.degree}"
        return [*lines, _row(width, "direction", "u", sign)]

    def _robots(self, glyphs: Glyphs, width: int, height: int) -> list[Text]:
        frame, setup = self._frame, self._frame.setup
        now = frame.distances
        full = max(float(np.nanmax(setup.distances(setup.starts.xy))), 1e-12)
        most = max(height - 12, 3)
        shown = len(now) if len(now) <= most else most - 1
        names = setup.names[:shown]
        decimals = min(max(3 - math.floor(math.log10(full)), 0), 6)  # four digits: 854.0 mm
        values = [f"{value:.{decimals}f}" for value in now[:shown]]
        value_width = max(len(f"{full:.{decimals}f}"), *(len(value) for value in values))
        longest = max((len(name) for name in names), default=0)
        name_width = min(longest, max(width - 5 - value_width, 4))  # the bar has what is left
        bar_width = width - 3 - name_width - 1 - value_width - 1
        what = f"to target [{setup.unit}]"
        titles = (f"distance {what}, {frame.known}", f"{what}, {frame.known}", what)
        known = frame.step and frame.step.plan.estimate
        stands = known.standing(setup.names) if known else []
        lines = [Text(_fitting(width, *titles), "dim", no_wrap=True)]
        for robot, (name, value) in enumerate(zip(names, values, strict=True)):
            color = self._colors[robot]
            mark = str(robot + 1)[-1] if glyphs.ascii else arrow(glyphs, frame.poses[robot, 2])
            line = Text.assemble(
                (mark, f"bold {color}"),
                (f" {name[:name_width]:<{name_width}} ", color),
                f"{value:>{value_width}} ",
            )
            room, part = min(max(bar_width, 0), 40), float(now[robot]) / full
            stood = Text(_fitting(room, "stands", ""), "yellow")
            line.append_text(stood if name in stands else bar(glyphs, room, part, color))
            lines.append(line)
        if shown < len(now):
            worst = _number(float(now[shown:].max()))
            lines.append(Text(f"and {len(now) - shown} more, at most {worst}", "dim"))
        return lines

    def _total(self, glyphs: Glyphs, width: int) -> list[Text]:
        frame = self._frame
        unit = frame.setup.unit
        total = _number(float(frame.distances.sum()))
        return [
            _row(width, "total error", "error", f"{total} {unit}"),
            sparkline(glyphs, frame.totals, min(width, 48), total=frame.steps_end),
        ]

    def _plan(self, glyphs: Glyphs, width: int) -> list[Text]:
        if self._frame.step is None or self._frame.step.plan.pauses:
            return []  # robots that stand follow no plan
        plan: Plan = self._frame.step.plan
        search = plan.search
        done = len(search.history) - 1
        most = max(self._frame.setup.iterations_max, done)
        unit = self._frame.setup.unit
        first = _number(float(search.history[0])) if done >= 0 else "?"
        last = _number(plan.cost)
        costs = (f"{first} {glyphs.to} {last} {unit}", f"{first} {glyphs.to} {last}", last)
        return [
            _row(width, "plan cost J", "J", *costs),
            sparkline(glyphs, search.history, min(width, 48), total=most + 1, log=True),
            _row(
                width, "iterations", "z", f"{done} of {most}, {search.ended}", f"{done} of {most}"
            ),
        ]

    def _effort(self, width: int) -> list[Text]:
        step = self._frame.step
        if step is None:
            return []
        solve = _row(width, "solve time", "solve", f"{milliseconds(step.solve_ns):.1f} ms")
        if step.deadline_missed:
            solve.append("  late" if width < COMPACT else "  deadline missed", "bold red")
        return [
            solve,
            _row(width, "evaluations", "evals", f"{step.plan.evaluations:,}".replace(",", " ")),
        ]

    def _events(self, height: int) -> list[Text]:
        """Return the newest events that fit in `height` lines, the newest at the bottom."""
        most = 0 if height < 16 else 1 if height < 24 else 2 if height < 36 else 6
        if not self._frame.events:
            return []
        shown = self._frame.events[-most:] if most else ()
        lines = [
            Text.assemble(
                (f"{event.time_s:7.1f} s  ", "dim"),
                (event.text if event.level == "info" else f"{event.level}: {event.text}"),
                style=LEVEL_STYLES.get(event.level, ""),
                no_wrap=True,
            )
            for event in shown
        ]
        return [Text() for _ in range(most - len(lines))] + lines

    def _last(self, width: int) -> list[Text]:
        lines = [Text(note, "bold red", no_wrap=True) for note in self._notes]
        aside = textwrap.wrap(self._aside, width, break_on_hyphens=False)  # links stay whole
        lines += [Text(line, "dim", no_wrap=True) for line in aside]
        if result := self._frame.result:
            ended = f"ended: {result.outcome}"
            lines.append(Text(ended, "bold", no_wrap=True))
            alarm = "bold red" if result.outcome is Outcome.ABORTED else ""
            lines += [
                Text(line, alarm, no_wrap=True) for line in textwrap.wrap(result.reason, width)
            ]
            if result.entered_obstacle:
                lines.append(Text("a robot entered an obstacle", "bold red"))
        return lines


def _row(width: int, label: str, short: str, *values: str) -> Text:
    """Return a row of a label and the first of several values that fits, with a short label if
    there is little width.
    """
    words = f"{short:<5} " if width < COMPACT else f"{label:<11} "
    return Text.assemble((words, "dim"), _fitting(width - len(words), *values), no_wrap=True)


def _fitting(width: int, *texts: str) -> str:
    """Return the first of several texts that fits, else the last: a number without its last digits
    would be another number.
    """
    return next((text for text in texts if len(text) <= width), texts[-1])


def _shortened(heading: str) -> list[str]:
    """Return a heading, and what remains of it without its last parts."""
    parts = heading.split(", ")
    return [", ".join(parts[:count]) for count in range(len(parts), 0, -1)]


def _number(value: float) -> str:
    """Return a length as text: without decimals from 100 on, with one decimal from 1 on, below 1
    with three significant digits.
    """
    if not math.isfinite(value):
        return str(value)
    size = abs(value)
    return f"{value:.0f}" if size >= 100 else f"{value:.1f}" if size >= 1 else f"{value:.3g}"
