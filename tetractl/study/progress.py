"""Progress of a study: on a terminal a bar with the time left, elsewhere a line now and then."""

from contextlib import ExitStack
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.progress import Progress

from tetractl.view.terminal.progress import duration, trials_bar

LINES = 10  # that a study prints on its way, where there is no terminal


class StudyProgress:
    """A `StudyObserver` that prints to a console; a context manager. A quiet one tells failures."""

    def __init__(self, console: Console, total: int, quiet: bool = False) -> None:
        self._console, self._total, self._quiet = console, total, quiet
        self._done = 0
        self._stack = ExitStack()
        self._bar: Progress | None = None

    def __enter__(self) -> Self:
        live = self._console.is_terminal and not self._quiet
        if live and not self._console.is_dumb_terminal:
            self._bar = self._stack.enter_context(trials_bar(self._console))
            self._task = self._bar.add_task("", total=self._total)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def expected(self, seconds: float, trials: int) -> None:
        """Print how long the study takes."""
        if not self._quiet:
            self._say(f"expected duration {duration(seconds)}, by the first {trials} trials")

    def ended(self, left_s: float | None) -> None:
        """Advance the bar, or print a line after each tenth of the trials."""
        self._done += 1
        left = "" if left_s is None else f"{duration(left_s)} left"
        if self._bar:
            self._bar.update(self._task, advance=1, description=left)
        elif not self._quiet and self._tenth():
            self._say(", ".join(filter(None, [f"{self._done} of {self._total} trials", left])))

    def _tenth(self) -> bool:
        return self._done * LINES // self._total > (self._done - 1) * LINES // self._total

    def failed(self, arm: str, trial: int, why: str) -> None:
        """Print a failure, above the bar."""
        self._say(f"failed: {arm}/{trial}: {why}")

    def _say(self, text: str) -> None:
        self._console.print(text, highlight=False, markup=False, soft_wrap=True)
