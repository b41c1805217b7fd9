"""Progress of a batch: on a terminal a bar with the time left, elsewhere a line for each trial."""

from contextlib import ExitStack
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
)
from rich.text import Text

from tetractl.core.trial import Result


class Tally:
    """Counts of the trials of a batch so far."""

    def __init__(self) -> None:
        self.n = 0
        self.errors: list[float] = []
        self.aborted = 0
        self.entered = 0

    def add(self, result: Result) -> None:
        """Count a finished trial."""
        self.errors.append(result.total_error)
        self.aborted += result.outcome == "aborted"
        self.entered += result.entered_obstacle

    def summary(self, unit: str) -> str:
        """Return the counts as text."""
        if not self.errors:
            return ""
        words = [f"mean total error {sum(self.errors) / len(self.errors):.1f} {unit}"]
        words += [f"{self.entered} entered an obstacle"] * bool(self.entered)
        words += [f"{self.aborted} aborted"] * bool(self.aborted)
        return ", ".join(words)


class BatchProgress:
    """A `BatchObserver` that prints to a console; a context manager.

    `total` is the number of trials to be run, `unit` the experiment's length unit.
    """

    def __init__(self, console: Console, total: int, unit: str = "mm") -> None:
        self._console, self._total, self._unit = console, total, unit
        self._tally = Tally()
        self._stack = ExitStack()
        self._bar: Progress | None = None

    def __enter__(self) -> Self:
        if self._console.is_terminal and not self._console.is_dumb_terminal:
            self._bar = self._stack.enter_context(trials_bar(self._console, _TimeLeft()))
            self._task = self._bar.add_task("", total=self._total)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def trial_started(self, index: int, n: int) -> None:
        """Set the number of trials of the batch, earlier ones included."""
        self._tally.n = n

    def trial_finished(self, index: int, result: Result) -> None:
        """Advance the bar, or print a line on the trial."""
        self._tally.add(result)
        if self._bar:
            self._bar.update(self._task, advance=1, description=self._tally.summary(self._unit))
        else:
            text = trial_line(index, max(self._tally.n, self._total), result, self._unit)
            self._console.print(text, highlight=False, markup=False, soft_wrap=True)


def trial_line(index: int, n: int, result: Result, unit: str) -> str:
    """Return a line on one finished trial, the `index`-th of n."""
    entered = ", entered an obstacle" if result.entered_obstacle else ""
    why = f" ({result.reason})" if result.outcome == "aborted" else ""
    return (
        f"trial {index + 1} of {n}: {result.outcome}{why}, total error "
        f"{result.total_error:.1f} {unit}, {result.steps} steps, {result.duration_s:.1f} s{entered}"
    )


def trials_bar(console: Console, *columns: ProgressColumn) -> Progress:
    """Return a bar of trials done, with further columns before its description."""
    return Progress(
        TextColumn("trials"),
        BarColumn(bar_width=30),
        MofNCompleteColumn(),
        *columns,
        TextColumn("{task.description}"),
        console=console,
        transient=True,
    )


class _TimeLeft(ProgressColumn):
    def render(self, task: Task) -> Text:
        left = task.time_remaining
        return Text("" if left is None else f"{duration(left)} left", "dim")


def duration(seconds: float) -> str:
    """Return a time as 45 s, 3 min 20 s or 2 h 5 min."""
    whole = max(round(seconds), 0)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
