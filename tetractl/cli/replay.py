"""`tetractl replay`: play a trial back."""

from pathlib import Path
from typing import Annotated

from tetractl.cli import ui
from tetractl.cli.options import Logs, option, switch
from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import Exit, UsageError, printable
from tetractl.log.read.find import find_logs


def replay(
    logs: Logs,
    rate: Annotated[
        float | None,
        option(
            "R",
            "Speed: seconds of the trial per second (1). Without a terminal all lines are "
            "printed at once unless --rate is given.",
        ),
    ] = None,
    start: Annotated[float, option("S", "Begin at this second of the trial.")] = 0.0,
    until: Annotated[float | None, option("S", "Stop at this second of the trial.")] = None,
    loop: Annotated[bool, switch("At the end, start again.", "--loop")] = False,
    paused: Annotated[bool, switch("Start paused, until a key is pressed.", "--paused")] = False,
) -> int:
    """Play trials back: arena, trails, plan, error, convergence, events.

    Times count from the first direction sent; a log of a lab begins earlier, so that it can be
    played from --start -5.

    Keys: space pause or continue; arrows 1 s back or forward; , . previous and next control step; E
    e previous and next event; Home End; + - twice and half the rate; p n previous and next trial; ?
    all keys; q quit.

    Without a terminal it prints one line per control step and event.

    Example: tetractl replay trial-000.mcap --rate 2 --start 5
    """
    from rich.console import Console

    from tetractl.log.read.reader import read_trial
    from tetractl.replay.player import Playback, Player, Recording, span
    from tetractl.view.terminal.replay_screen import play, print_lines

    ui.require_positive(rate)
    paths, wall, screen = find_logs(logs), MonotonicClock(), ui.is_terminal()
    if paused and not screen:
        raise UsageError("--paused needs a terminal, where a key continues")
    if loop and not screen and len(paths) > 1:
        raise UsageError(
            "--loop without a terminal takes one log: other logs would never be played"
        )
    damaged = False

    def opened(path: Path, again: bool = False) -> Recording:
        nonlocal damaged
        recording = Recording(read_trial(path) if again else ui.open_trial(path))
        damaged |= recording.log.damage is not None
        return recording

    def turn_to(index: int) -> Player:
        """Return a player of another trial, with the rate of the last player and paused like it."""
        nonlocal player
        found, paused = opened(paths[index], again=True), player.state is Playback.PAUSED
        whole = (found.began_ns, found.end_ns)
        player = Player(found, wall, whole, rate=player.rate, loop=loop, paused=paused)
        return player

    try:
        if screen:
            first = opened(paths[0])
            played = span(first, start, until)
            player = Player(first, wall, played, rate=rate or 1.0, loop=loop, paused=paused)
            if play(Console(), player, len(paths), turn_to):
                return Exit.INTERRUPTED
        for path in () if screen else paths:
            recording = opened(path)
            if len(paths) > 1:
                print(printable(f"{path}:"))
            print_lines(recording, wall, span(recording, start, until), rate=rate, loop=loop)
    except KeyboardInterrupt:
        return Exit.INTERRUPTED
    return Exit.FAILED if damaged else Exit.DONE
