"""A full-screen display in the terminal, on which the dashboard of a trial is shown."""

from typing import Self

from rich.console import Console, RenderableType
from rich.live import Live


def can_show_screens(console: Console) -> bool:
    """Check whether a console can show changing screens: it moves its cursor and has UTF-8."""
    return console.is_terminal and not (console.is_dumb_terminal or console.options.ascii_only)


class Screen:
    """A display that fills the terminal, and restores it when it is closed; a context manager.

    Text printed to the console's own stream in the meantime appears above the image. Text for the
    other stream goes to that stream.
    """

    def __init__(self, console: Console) -> None:
        self._live = Live(
            console=console,
            screen=True,
            auto_refresh=False,
            redirect_stdout=not console.stderr,
            redirect_stderr=console.stderr,
        )
        self._shown = False

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    @property
    def is_open(self) -> bool:
        """Whether the display fills the terminal now."""
        return self._live.is_started

    def open(self) -> None:
        """Take over the whole terminal, and show the last image again if there is one."""
        self._live.start()
        if self._shown:
            self._live.refresh()

    def close(self) -> None:
        """Restore the terminal as it was before."""
        self._live.stop()

    def show(self, picture: RenderableType) -> None:
        """Show an image in place of the last one.

        If the display is closed, it is shown after `open`.
        """
        self._shown = True
        self._live.update(picture, refresh=True)
