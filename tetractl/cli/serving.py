"""What `--serve` adds to a command: a live WebSocket for Foxglove and Lichtblick."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.core.errors import Exit, UsageError

if TYPE_CHECKING:
    from tetractl.core.clock import Clock
    from tetractl.core.protocols import Observer
    from tetractl.serve.recorded import ServedReplay

PORT = 8765
"""Where Foxglove and Lichtblick look for a WebSocket unless told otherwise."""

Serve = Annotated[
    bool,
    typer.Option(
        "--serve", help="Show it in Foxglove or Lichtblick too, by a link to a live WebSocket."
    ),
]
Port = Annotated[
    int | None,
    typer.Option(
        min=0,
        max=65535,
        metavar="N",
        help=f"With --serve: its TCP port; 0 is any that is free.  \\[{PORT}]",
    ),
]


def wanted_port(serve: bool, port: int | None) -> int | None:
    """Return the port to serve at, None for not at all; UsageError for a port without --serve."""
    if port is not None and not serve:
        raise UsageError("--port belongs to --serve")
    return PORT if serve and port is None else port


@contextmanager
def served_run(name: str, port: int | None) -> "Iterator[list[Observer]]":
    """Serve the trials that call the observers of this block; none for no port."""
    if port is None:
        yield []
        return
    with _extra():
        from tetractl.serve.server import ViewerServer
    from tetractl.core.clock import MonotonicClock
    from tetractl.serve.running import ServedRun

    with ViewerServer(name, port) as server:
        print(f"served at {server.url}", file=sys.stderr)
        yield [ServedRun(server, MonotonicClock())]


def served_replay(
    path: Path,
    wall: "Clock",
    seconds: tuple[float, float | None],
    *,
    rate: float = 1.0,
    loop: bool = False,
    paused: bool = False,
    port: int,
    viewer: str = "",
) -> "ServedReplay":
    """Return a log being served, with a player of the span `seconds` of its trial.

    `viewer` is the address of a viewer whose page may read it, beside those always known.
    """
    with _extra():
        from tetractl.serve.recorded import ServedReplay
    from tetractl.log.read.reader import trial_of
    from tetractl.log.read.salvage import scan
    from tetractl.replay.player import Player, span
    from tetractl.replay.recording import Recording
    from tetractl.view.terminal.damage import warn_of_damage

    contents = scan(path)
    recording = Recording(trial_of(contents))
    played = span(recording, *seconds)
    warn_of_damage(recording.log)
    player = Player(recording, wall, played, rate=rate, loop=loop, paused=paused)
    return ServedReplay(contents, player, port, viewer)


def play_served(served: "ServedReplay", wall: "Clock", screen: bool) -> int:
    """Play until q or Ctrl-C is pressed, on the terminal too where there is a `screen`."""
    with served.server:
        print(f"served at {served.server.url}", flush=True)
        if screen:
            from rich.console import Console

            from tetractl.view.terminal.replay_screen import play

            note = f"served at {served.server.url}"
            if play(Console(), served.player, follow=served.follow, note=note):
                return Exit.INTERRUPTED
        else:
            served.play(wall)
    return Exit.FAILED if served.player.recording.log.damage else Exit.DONE


@contextmanager
def _extra() -> Iterator[None]:
    """Turn the failed import of an extra that is not installed into a UsageError."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] != "websockets":
            raise
        raise UsageError(
            "the live WebSocket needs websockets, which is not installed",
            "pip install 'tetractl[serve]'",
        ) from error
