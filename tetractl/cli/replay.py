"""The command `tetractl replay`, which plays recorded trials in the terminal."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tetractl.cli import ui
from tetractl.cli.options import Logs, option, switch
from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import Exit, UsageError, printable
from tetractl.log.read.find import find_logs
from tetractl.tools.table.terminal_table import open_console
from tetractl.tools.terminal import has_keys

if TYPE_CHECKING:
    from rich.console import Console

    from tetractl.view.player import Player, Recording


def replay(
    logs: Logs,
    rate: Annotated[
        float | None,
        option(
            "R",
            "Speed of replay: seconds of the trial per real second (1). Without a terminal, "
            "all lines are printed at once unless --rate is given.",
        ),
    ] = None,
    start: Annotated[float, option("S", "Begin at this second of the trial.")] = 0.0,
    until: Annotated[float | None, option("S", "Stop at this second of the trial.")] = None,
    loop: Annotated[bool, switch("Start again at the end.", "--loop")] = False,
    paused: Annotated[bool, switch("Start paused, until a key is pressed.", "--paused")] = False,
) -> int:
    """Play trials back: arena, trails, plan, error, convergence, events.

    Times count from the first direction that was sent. A log from a lab begins earlier, and can be
    played for example from --start -5.

    Keys: space pauses or continues; the arrows go back or forward by 1 s; , and . go to the
    previous and next control step, E and e to the previous and next event, Home and End to the
    start and end, p and n to the previous and next trial; + and - double and halve the rate; ?
    shows all keys; q quits.

    Without a terminal, the command prints one line for each control step and event.

    Example: tetractl replay trial-000.mcap --rate 2 --start 5
    """
    from tetractl.view.terminal.screen import can_show_screens

    if rate is not None and not 0 < rate < float("inf"):
        raise UsageError(f"--rate must be above 0, not {rate:g}")
    paths = find_logs(logs)
    console = open_console()
    on_screen = has_keys() and can_show_screens(console)
    if paused and not on_screen:
        raise UsageError("--paused needs a terminal, because a key continues the replay")
    if loop and not on_screen and len(paths) > 1:
        raise UsageError(
            "without a terminal, --loop accepts only one log, because other logs would "
            "never be played"
        )
    playlist = Playlist(paths, rate, start, until, loop)
    try:
        if on_screen:
            stopped = playlist.play(console, paused)
        else:
            stopped = False
            playlist.print_all()
    except KeyboardInterrupt:
        stopped = True
    if stopped:
        return Exit.INTERRUPTED
    return Exit.FAILED if playlist.damaged else Exit.DONE


class Playlist:
    """The logs that `tetractl replay` plays, one after another.

    The first log that is shown is played from `start_s` to `until_s`, and the others are played
    whole. Without a terminal, no key can turn to another log, and each is printed from `start_s` to
    `until_s`.

    Args:
        paths: The files of the logs.
        rate: Playing speed, as a multiple of real time. None for the default.
        start_s: Time of the trial at which the first log begins [s].
        until_s: Time at which the first log ends [s]. None for the end of the trial.
        loop: Whether to begin again at the end.
    """

    def __init__(
        self,
        paths: list[Path],
        rate: float | None,
        start_s: float,
        until_s: float | None,
        loop: bool,
    ) -> None:
        self.damaged = False
        self._paths = paths
        self._rate = rate
        self._start_s = start_s
        self._until_s = until_s
        self._loop = loop
        self._wall = MonotonicClock()

    def play(self, console: "Console", paused: bool) -> bool:
        """Play the logs on the terminal's screen until q is pressed or a signal arrives.

        Returns:
            Whether a signal ended the replay.
        """
        from tetractl.view.player import Player, span
        from tetractl.view.terminal.replay_screen import play_trials

        recording = self._open(self._paths[0])
        player = Player(
            recording,
            self._wall,
            span(recording, self._start_s, self._until_s),
            rate=self._rate or 1.0,
            loop=self._loop,
            paused=paused,
        )
        return play_trials(console, player, len(self._paths), self._turn_to)

    def print_all(self) -> None:
        """Print the steps and events of each log as lines."""
        from tetractl.view.player import span
        from tetractl.view.terminal.replay_screen import print_lines

        for path in self._paths:
            recording = self._open(path)
            if len(self._paths) > 1:
                print(printable(f"{path}:"))
            times_ns = span(recording, self._start_s, self._until_s)
            print_lines(recording, self._wall, times_ns, rate=self._rate, loop=self._loop)

    def _turn_to(self, index: int, player: "Player") -> "Player":
        """Return a player of another log, with the speed of `player`, and paused if that is."""
        from tetractl.view.player import Playback, Player

        recording = self._open(self._paths[index], on_screen=True)
        return Player(
            recording,
            self._wall,
            (recording.log.began_ns, recording.end_ns),
            rate=player.rate,
            loop=self._loop,
            paused=player.state is Playback.PAUSED,
        )

    def _open(self, path: Path, on_screen: bool = False) -> "Recording":
        """Read a log.

        Its damage is printed unless the screen is open, because the screen shows it.
        """
        from tetractl.log.read.reader import read_trial
        from tetractl.view.player import Recording

        log = read_trial(path) if on_screen else ui.open_trial(path)
        if log.damage is not None:
            self.damaged = True
        return Recording(log)
