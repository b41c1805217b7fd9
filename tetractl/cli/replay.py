"""`tetractl replay`: play a trial back."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.cli.caution import Yes
from tetractl.cli.serving import Port, Serve, play_served, served_replay, wanted_port
from tetractl.cli.trials import PlantChoice
from tetractl.core.errors import Exit, UsageError

if TYPE_CHECKING:
    from tetractl.core.clock import Clock


def replay(
    logs: Annotated[
        list[str], typer.Argument(metavar="LOG...", help="Logs of trials, folders or globs.")
    ],
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
    serve: Serve = False,
    port: Port = None,
    through: Annotated[
        PlantChoice | None,
        typer.Option(
            help="Drive a simulation, or the robots of the log's lab, with the recorded commands "
            "instead: open loop, in a trial of its own."
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", metavar="DIR", help="With --through: folder for the new log."),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option("--plot", metavar="FILE", help="With --through: draw both paths."),
    ] = None,
    yes: Yes = False,
) -> int:
    """Play trials back: arena, trails, plan, error, convergence, events.

    Times count from the first direction sent; --start -5 shows what came before it in the lab.

    Keys: space pause or go on; arrows 1 s back or on; , . previous and next control step;
    E e previous and next event; Home End; + - twice and half the rate;
    p n previous and next trial; ? all keys; q quit.

    Without a terminal it prints one line a control step and event.

    With --serve a viewer plays, pauses, seeks and sets the rate as the keys do, until q or Ctrl-C.

    With --through it prints how far the recorded and the new path of each robot go apart. In the
    lab the robots have to stand on their starts, and all checks of a run apply.

    Example: tetractl replay trial-000.mcap --rate 2 --start 5
    """
    from tetractl.core.clock import MonotonicClock
    from tetractl.log.read.find import find_logs

    if through is not None:
        from tetractl.cli.redrive import redrive
        from tetractl.log.read.find import find_log

        if (rate, start, until, loop, paused) != (None, 0.0, None, False, False):
            raise UsageError("--through drives the whole trial in its own time")
        if serve or port is not None:
            raise UsageError("--serve shows a log: drive first, then replay the new one")
        if len(logs) > 1:
            raise UsageError("--through takes one log")
        return redrive(find_log(logs[0]), through.value, out, picture, yes)
    if (out, picture, yes) != (None, None, False):
        raise UsageError("--out, --plot and --yes belong to --through")
    if rate is not None and not 0 < rate < float("inf"):
        raise UsageError(f"--rate must be above 0, and is {rate:g}")
    served_port = wanted_port(serve, port)
    paths, wall = find_logs(logs), MonotonicClock()
    screen = _is_terminal()
    if served_port is not None and len(paths) > 1:
        raise UsageError("--serve takes one log")
    if paused and not screen and served_port is None:
        raise UsageError("--paused needs a terminal: there are no keys to go on with")
    if loop and not screen and len(paths) > 1:
        raise UsageError("--loop without a terminal needs one log: the others would never come")
    try:
        if served_port is not None:
            served = served_replay(
                paths[0],
                wall,
                (start, until),
                rate=rate or 1.0,
                loop=loop,
                paused=paused,
                port=served_port,
            )
            return play_served(served, wall, screen)
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
    from tetractl.replay.player import Playback, Player, span
    from tetractl.replay.recording import Recording
    from tetractl.view.terminal.damage import warn_of_damage
    from tetractl.view.terminal.replay_screen import play

    def opened(index: int) -> Player:
        """Return a player of another trial, which goes on at the rate of the one before."""
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

    first = Recording(read_trial(paths[0]))
    played = span(first, *seconds)
    warn_of_damage(first.log)
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
    from tetractl.core.text import printable
    from tetractl.log.read.reader import read_trial
    from tetractl.replay.player import span
    from tetractl.replay.recording import Recording
    from tetractl.view.terminal.damage import warn_of_damage
    from tetractl.view.terminal.replay_text import print_lines

    damaged = False
    for path in paths:
        recording = Recording(read_trial(path))
        warn_of_damage(recording.log)
        damaged |= recording.log.damage is not None
        if len(paths) > 1:
            print(printable(f"{path}:"))
        print_lines(recording, wall, span(recording, *seconds), rate=rate, loop=loop)
    return Exit.FAILED if damaged else Exit.DONE


def _is_terminal() -> bool:
    import os

    dumb = os.environ.get("TERM", "dumb") in ("dumb", "unknown", "")
    return sys.stdin.isatty() and sys.stdout.isatty() and not dumb
