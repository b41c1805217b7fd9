"""`tetractl replay`: play a trial back."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from tetractl.core.errors import Exit, UsageError


def replay(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Log of a trial.")],
    rate: Annotated[
        float | None,
        typer.Option(
            metavar="R",
            help="Seconds of the trial per second (1). Without a terminal the lines come at once "
            "unless this is given.",
        ),
    ] = None,
    start: Annotated[
        float, typer.Option(metavar="S", help="Begin at this second of the trial.")
    ] = 0.0,
    until: Annotated[
        float | None, typer.Option(metavar="S", help="Stop at this second of the trial.")
    ] = None,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again at the end.")] = False,
    paused: Annotated[bool, typer.Option("--paused", help="Wait for a key at first.")] = False,
) -> int:
    """Play a trial back: arena, trails, plan, error, convergence.

    Keys: space pause or go on; arrows 1 s back or on; . next control step;
    + twice the rate; - half of it; q quit.

    Without a terminal it prints one line a control step.

    Example: tetractl replay trial-000.mcap --rate 2 --start 5
    """
    from tetractl.core.clock import MonotonicClock
    from tetractl.log.read.reader import read_trial
    from tetractl.replay.player import Player, span
    from tetractl.replay.recording import Recording
    from tetractl.view.terminal.damage import warn_of_damage

    if rate is not None and not 0 < rate < float("inf"):
        raise UsageError(f"--rate must be above 0, and is {rate:g}")
    trial = read_trial(log)
    recording = Recording(trial)
    played = span(recording, start, until)
    wall = MonotonicClock()
    warn_of_damage(trial)
    if _is_terminal():
        from rich.console import Console

        from tetractl.view.terminal.replay_screen import play

        player = Player(recording, wall, played, rate=rate or 1.0, loop=loop, paused=paused)
        play(Console(), recording, player)
    else:
        from tetractl.view.terminal.replay_text import print_steps

        if paused:
            raise UsageError("--paused needs a terminal: there are no keys to go on with")
        print_steps(recording, wall, played, rate=rate, loop=loop)
    return Exit.FAILED if trial.damage else Exit.DONE


def _is_terminal() -> bool:
    import os

    dumb = os.environ.get("TERM", "dumb") in ("dumb", "unknown", "")
    return sys.stdin.isatty() and sys.stdout.isatty() and not dumb
