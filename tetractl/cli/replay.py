"""`tetractl replay`: play a trial back."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.cli.options import Logs, open_trial
from tetractl.core.errors import Exit, UsageError

if TYPE_CHECKING:
    from tetractl.core.clock import Clock


def replay(
    logs: Logs,
    rate: Annotated[
        float | None,
        typer.Option(
            metavar="R",
            help="Speed: seconds of the trial per second (1). Without a terminal all lines "
            "are printed at once unless --rate is given.",
        ),
    ] = None,
    start: Annotated[
        float, typer.Option(metavar="S", help="Begin at this second of the trial.")
    ] = 0.0,
    until: Annotated[
        float | None, typer.Option(metavar="S", help="Stop at this second of the trial.")
    ] = None,
    loop: Annotated[bool, typer.Option("--loop", help="At the end, start again.")] = False,
    paused: Annotated[
        bool, typer.Option("--paused", help="Start paused, until a key is pressed.")
    ] = False,
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
    from tetractl.core.clock import MonotonicClock
    from tetractl.log.read.find import find_logs

    if rate is not None and not 0 < rate < float("inf"):
        raise UsageError(f"--rate must be above 0, not {rate:g}")
    paths, wall = find_logs(logs), MonotonicClock()
    screen = is_terminal()
    if paused and not screen:
        raise UsageError("--paused needs a terminal, where a key continues")
    if loop and not screen and len(paths) > 1:
        raise UsageError(
            "--loop without a terminal takes one log: other logs would never be played"
        )
    try:
        if screen:
            return _on_screen(paths, wall, (start, until), rate or 1.0, loop, paused)
        return _as_text(paths, wall, (start, until), rate, loop)
    except KeyboardInterrupt:
        return Exit.INTERRUPTED


def _on_screen(
    paths: list[Path],
    wall: "Clock",
    seconds: tuple[float, float | None],
    rate: float,
    loop: bool,
    paused: bool,
) -> int:
    from rich.console import Console

    from tetractl.log.read.reader import read_trial
    from tetractl.replay.player import Playback, Player, Recording, span
    from tetractl.view.terminal.replay_screen import play

    def opened(index: int) -> Player:
        """Return a player of trial `index`, with the rate of the previous player and paused like
        it.
        """
        nonlocal player, damaged
        recording = Recording(read_trial(paths[index]))
        damaged |= recording.log.damage is not None
        played = (recording.began_ns, recording.end_ns)
        player = Player(
            recording,
            wall,
            played,
            rate=player.rate,
            loop=loop,
            paused=player.state is Playback.PAUSED,
        )
        return player

    first = Recording(open_trial(paths[0]))
    played = span(first, *seconds)
    damaged = first.log.damage is not None
    player = Player(first, wall, played, rate=rate, loop=loop, paused=paused)
    if play(Console(), player, len(paths), opened):
        return Exit.INTERRUPTED
    return Exit.FAILED if damaged else Exit.DONE


def _as_text(
    paths: list[Path],
    wall: "Clock",
    seconds: tuple[float, float | None],
    rate: float | None,
    loop: bool,
) -> int:
    from tetractl.core.errors import printable
    from tetractl.replay.player import Recording, span
    from tetractl.view.terminal.replay_screen import print_lines

    damaged = False
    for path in paths:
        recording = Recording(open_trial(path))
        damaged |= recording.log.damage is not None
        if len(paths) > 1:
            print(printable(f"{path}:"))
        print_lines(recording, wall, span(recording, *seconds), rate=rate, loop=loop)
    return Exit.FAILED if damaged else Exit.DONE


def is_terminal() -> bool:
    """Return whether stdin and stdout are a terminal that can show a screen."""
    import os

    dumb = os.environ.get("TERM", "dumb") in ("dumb", "unknown", "")
    return sys.stdin.isatty() and sys.stdout.isatty() and not dumb
