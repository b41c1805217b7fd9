"""Shows the progress of a run: on a terminal a bar with the remaining time, otherwise lines."""

import sys
import time
from collections.abc import Callable
from pkgutil import resolve_name
from typing import Any, Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from tetractl.core.trial import Result
from tetractl.run.batch import Ending, RunObserver
from tetractl.run.task import Task

LINES = 10  # number of progress lines that a study prints without a terminal
RESULTS_TO_EXPECT = 3  # least number of results from which a study's duration is estimated
PAUSE_S = 10.0  # least time between two progress lines of a script [s]
BAR_PAUSE_S = 0.2  # least time between two changes of a notebook's bar [s]


class Tally:
    """Counts of a batch's trials so far, by outcome.

    `began_s` is when its first trial began [s].
    """

    def __init__(self) -> None:
        self.began_s = 0.0
        self.errors: list[float] = []
        self.aborted = 0
        self.entered = 0

    def add(self, result: Result) -> None:
        """Add the result of a finished trial.

        Its total error is stored, and it is counted if it was aborted or if a robot entered an
        obstacle.
        """
        self.errors.append(result.total_error)
        self.aborted += result.outcome == "aborted"
        self.entered += result.entered_obstacle

    def summary(self, unit: str) -> str:
        """Describe the finished trials in one line: mean total error, entered obstacles, aborts.

        The line is empty before the first trial has finished.
        """
        if not self.errors:
            return ""
        words = [f"mean total error {sum(self.errors) / len(self.errors):.1f} {unit}"]
        if self.entered:
            words.append(f"{self.entered} entered an obstacle")
        if self.aborted:
            words.append(f"{self.aborted} aborted")
        return ", ".join(words)


class _TrialsBar(RunObserver):
    """A progress bar of trials, shown on a terminal unless `quiet`. It is a context manager."""

    def __init__(self, console: Console, total: int, quiet: bool = False) -> None:
        self._console = console
        self._total = total
        live = console.is_terminal and not (console.is_dumb_terminal or console.quiet or quiet)
        self._done = 0
        columns = (TextColumn("trials"), BarColumn(bar_width=30), MofNCompleteColumn())
        words = TextColumn("{task.description}")
        self._bar = Progress(*columns, words, console=console, transient=True) if live else None

    def __enter__(self) -> Self:
        if self._bar:
            self._bar.start()
            self._task = self._bar.add_task("", total=self._total)
        return self

    def __exit__(self, *error: object) -> None:
        if self._bar:
            self._bar.stop()

    def _advance(self, *words: str) -> None:
        self._done += 1
        if self._bar:
            self._bar.update(self._task, advance=1, description=", ".join(filter(None, words)))

    def _say(self, text: str) -> None:
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)


class BatchProgress(_TrialsBar):
    """The progress of a batch: a bar that also shows the errors of the trials so far.

    It is a `RunObserver`. Without a terminal, it prints a line for each trial.

    Args:
        console: Where to print.
        total: Number of trials.
        unit: The experiment's length unit.
    """

    def __init__(self, console: Console, total: int, unit: str = "mm") -> None:
        super().__init__(console, total)
        self._tally = Tally()
        self._unit = unit

    def trial_ended(self, ending: Ending) -> None:
        """Advance the bar or, without a bar, print the trial's line if it has a result."""
        if ending.result:
            self._tally.add(ending.result)
        self._advance(_left(ending), self._tally.summary(self._unit))
        if ending.result and not self._bar:
            self._say(trial_line(ending.task, ending.result, self._unit))


class StudyProgress(_TrialsBar):
    """The progress of a study: a bar, the failures of trials, and the expected duration.

    It is a `RunObserver`. Without a terminal, it prints a line after each tenth of the trials.

    Args:
        console: Where to print.
        total: Number of trials.
        quiet: Whether to print only failures.
    """

    def __init__(self, console: Console, total: int, quiet: bool = False) -> None:
        super().__init__(console, total, quiet)
        self._quiet = quiet
        self._results = 0
        self._expected = False  # whether the expected duration was printed

    def trial_ended(self, ending: Ending) -> None:
        """Print a failure and the expected duration; advance the bar, or print a line.

        The expected duration is printed once. Without a bar, about LINES lines are printed in all.
        """
        if ending.failure:
            self._say(f"failed: {ending.task.arm}/{ending.task.trial}: {ending.failure}")
        if ending.result is not None:
            self._results += 1
        enough = self._results >= RESULTS_TO_EXPECT and ending.every_arm
        if enough and not (self._expected or self._quiet):
            self._expected = True
            if ending.left_s:
                by = f"estimated from the first {self._results} trials"
                self._say(f"expected duration {duration(ending.left_s)}, {by}")
        lines_before = self._lines()
        self._advance(_left(ending))
        if self._lines() > lines_before and not (self._bar or self._quiet):
            words = (f"{self._done} of {self._total} trials", _left(ending))
            self._say(", ".join(filter(None, words)))

    def _lines(self) -> int:
        """Return how many of the LINES should have been printed after the trials so far."""
        return self._done * LINES // self._total


def progress_of_script(total: int) -> RunObserver:
    """Create the progress display of `total` trials for a script or, in a notebook, for a cell."""
    if "IPython" in sys.modules:
        shell = resolve_name("IPython:get_ipython")()
        if hasattr(shell, "kernel"):  # a terminal's shell has none
            return NotebookProgress(total, resolve_name("IPython.display:display"))
    return ScriptProgress(total)


class ScriptProgress(RunObserver):
    """The progress of trials in a script, printed to stderr as lines.

    It is a `RunObserver`. At most every PAUSE_S, it prints how many of `total` trials have ended
    and how long the others will take. `now_s` returns the time [s].
    """

    def __init__(self, total: int, now_s: Callable[[], float] = time.monotonic) -> None:
        self._total = total
        self._now_s = now_s
        self._done = 0
        self._said_s = now_s()

    def trial_ended(self, ending: Ending) -> None:
        """Count a trial that has ended, and print a line if the last one was PAUSE_S ago.

        It is printed to stderr.
        """
        self._done += 1
        now_s = self._now_s()
        if now_s - self._said_s < PAUSE_S:
            return
        self._said_s = now_s
        words = [f"{self._done} of {self._total} trials", _left(ending)]
        print("; ".join(filter(None, words)), file=sys.stderr, flush=True)


class NotebookProgress(RunObserver):
    """The progress of trials in a notebook: one output of the cell, a bar that grows.

    Args:
        total: Number of trials.
        display: IPython's function of this name, which every front end supports.
        now_s: Returns the time [s].
    """

    def __init__(
        self,
        total: int,
        display: Callable[..., Any],
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._total = total
        self._now_s = now_s
        self._done = 0
        self._left = ""
        self._shown_s = now_s()
        self._output = display(self, display_id=True)

    def trial_ended(self, ending: Ending) -> None:
        """Count a trial that has ended, and change the bar.

        The bar changes at most every BAR_PAUSE_S, and when all trials have ended.
        """
        self._done += 1
        self._left = _left(ending)
        now_s = self._now_s()
        if self._done == self._total or now_s - self._shown_s >= BAR_PAUSE_S:
            self._shown_s = now_s
            self._output.update(self)

    def __repr__(self) -> str:
        words = [f"{self._done} of {self._total} trials"]
        if self._done < self._total:
            words.append(self._left)
        return "; ".join(filter(None, words))

    def _repr_html_(self) -> str:
        return f'<progress value="{self._done}" max="{self._total}"></progress> {self!r}'


def _left(ending: Ending) -> str:
    """Estimate, as text, how long the remaining trials will take. Empty if that is unknown."""
    return "" if ending.left_s is None else f"{duration(ending.left_s)} left"


def trial_line(task: Task, result: Result, unit: str) -> str:
    """Return a line about a finished trial.

    Args:
        task: The trial.
        result: Its result.
        unit: The experiment's length unit.
    """
    entered = ", entered an obstacle" if result.entered_obstacle else ""
    why = f" ({result.reason})" if result.outcome == "aborted" else ""
    return (
        f"trial {task.trial + 1} of {task.count}: {result.outcome}{why}, total error "
        f"{result.total_error:.1f} {unit}, {result.steps} steps, {result.duration_s:.1f} s{entered}"
    )


def duration(seconds: float) -> str:
    """Return a time [s], rounded to whole seconds, as text such as 45 s, 3 min 20 s or 2 h 5 min.

    Seconds are left out from one hour on. A negative time counts as 0.
    """
    whole_s = max(round(seconds), 0)
    if whole_s < 60:
        return f"{whole_s} s"
    if whole_s < 3600:
        return f"{whole_s // 60} min {whole_s % 60} s"
    return f"{whole_s // 3600} h {whole_s % 3600 // 60} min"
