"""Plays recorded trials on the terminal's alternate screen, controlled by keys. Without a terminal
it prints a line for each control step and event.
"""

import math
from collections.abc import Callable

from rich.console import Console, ConsoleOptions, RenderResult
from rich.live import Live
from rich.text import Text

from tetractl.core.clock import Clock
from tetractl.core.colors import robot_colors
from tetractl.core.plan import State
from tetractl.core.table.table import lengths
from tetractl.log.read.trial_log import Event
from tetractl.replay.player import Playback, Player, Recording
from tetractl.view.terminal.dashboard import Dashboard, Footer, fitted, printed
from tetractl.view.terminal.glyphs import Glyphs, glyphs_for
from tetractl.view.terminal.keys import Keyboard

SPACE = {Playback.PLAYING: "pause", Playback.PAUSED: "play ", Playback.ENDED: "again"}
TURNS = {"n": 1, "p": -1}


def play(
    console: Console,
    player: Player,
    count: int = 1,
    turn_to: Callable[[int], Player] | None = None,
) -> bool:
    """Play the first of `count` trials until q is pressed; the keys n and p go to the next and the
    previous trial.

    `turn_to(i)` returns the player of trial i. Returns whether a signal ended the play.
    """
    index, drawn, helping = 0, None, False
    live = Live(console=console, screen=True, auto_refresh=False, redirect_stderr=False)
    # the keyboard is the outer context: no signal interrupts before the screen is restored
    with Keyboard(leave=live.stop, back=lambda: live.start(refresh=True)) as keyboard, live:
        while player.state is not Playback.QUIT:
            player.update()
            scene = (index, player.now, player.rate, player.state, console.size, helping)
            if scene != drawn:
                drawn, glyphs = scene, glyphs_for(console)
                place = (index + 1, count)
                picture = Help(glyphs) if helping else dashboard(player, glyphs, place)
                live.update(picture, refresh=True)
            for key in keyboard.read(1 / 15):
                if turn_to and key in TURNS and 0 <= index + TURNS[key] < count:
                    index += TURNS[key]
                    player = turn_to(index)
                helping = key == "?" and not helping
                player.press(key)
    return keyboard.interrupted


def dashboard(player: Player, glyphs: Glyphs, place: tuple[int, int] = (1, 1)) -> Dashboard:
    """Return the dashboard at the player's time; it states that this is log `place[0]` of
    `place[1]`.
    """
    recording, now_ns = player.recording, player.now
    setup, log = recording.log.start.setup, recording.log
    sign = glyphs.play if player.state is Playback.PLAYING else glyphs.pause
    now_s, end_s = recording.elapsed_s(now_ns), recording.elapsed_s(recording.end_ns)
    wide = len(f"{end_s:.1f}")
    footer = Footer(
        left=f"{sign} {player.rate:g}{glyphs.times}",
        fraction=now_s / end_s if end_s > 0 else 1.0,
        right=f"{now_s:{wide}.1f} / {end_s:.1f} s",
        hints=(
            f"space {SPACE.get(player.state, '')}",
            "? keys",
            "q quit",
            *(["n next trial"] if place[0] < place[1] else []),
            f"{glyphs.left_right} {glyphs.plus_minus}1 s",
            ". step",
            "e event",
            "+/- rate",
        ),
    )
    number, count = place
    which = f" ({number} of {count})" if count > 1 else ""
    heading = f"{setup.name}, trial {log.start.trial}{which}"
    notes = ("damaged log", *log.damage.lost) if log.damage else ()
    colors = robot_colors(setup.names, setup.colors)
    return Dashboard(recording.at(now_ns), colors, heading, footer, notes)


class Help:
    """Shows the list of keys, on all the space available; the library rich prints it."""

    def __init__(self, glyphs: Glyphs) -> None:
        self._keys = {
            "space": "pause or continue; at the end: play again from the start",
            glyphs.left_right: "1 s back or forward",
            ", .": "previous or next control step, and pause",
            "E e": "previous or next event, and pause",
            "Home End": "start or end",
            "+ -": "double or halve the rate",
            "p n": "previous or next trial, if several logs are given",
            "?": "show or hide this list",
            "q": "quit",
        }

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        height, wide = options.height or console.height, max(map(len, self._keys))
        lines = [Text("Keys of the player", "bold"), Text()]
        lines = lines if height > len(self._keys) + 2 else []
        for key, does in self._keys.items():
            lines.append(Text.assemble((f" {key:<{wide}}", "bold"), f"  {does}"))
        lines = [*lines, *[Text()] * height][:height]
        width = options.max_width
        yield from printed([fitted(console, line, width) for line in lines], width)


def print_lines(
    recording: Recording,
    wall: Clock,
    span: tuple[int, int],
    *,
    rate: float | None = None,
    loop: bool = False,
) -> None:
    """Print the control steps and events of a span [ns], in the order of their times.

    Lines appear at `rate` times the trial's speed. Without a rate they appear at once or, with
    `loop`, at the trial's speed.
    """
    start_ns, until_ns = span
    pace = rate or (1.0 if loop else None)
    lines = _lines(recording, start_ns, until_ns)
    while True:
        began = wall.now()
        for time_ns, line in lines:
            if pace is not None:
                wall.sleep_until(began + math.ceil((time_ns - start_ns) / pace))
            print(line, flush=pace is not None)
        if not loop or not lines:
            return
        wall.sleep_until(began + math.ceil((until_ns - start_ns) / (pace or 1.0)))


def _lines(recording: Recording, start_ns: int, until_ns: int) -> list[tuple[int, str]]:
    """Return the times [ns] and texts of the lines to print, in order of time; at the same time a
    step comes before events, and the result comes last.
    """
    steps = [(int(ns), step_line(recording, i)) for i, ns in enumerate(recording.step_ns)]
    lines = map(event_line, recording.events)
    events = list(zip(map(int, recording.event_ns), lines, strict=True))
    found = sorted([*steps, *events], key=lambda item: item[0])
    if recording.log.result is not None:
        found.append((recording.end_ns, result_line(recording)))
    return [(ns, line) for ns, line in found if start_ns <= ns <= until_ns]


def result_line(recording: Recording) -> str:
    """Return the end of the trial, and its final error, as a line of text."""
    end = recording.at(recording.end_ns)
    result = recording.log.result
    assert result is not None, "the caller has checked this"
    unit = recording.log.start.setup.unit
    error = lengths(result.total_error)(result.total_error)
    time_s = recording.elapsed_s(recording.end_ns)
    return f"{time_s:6.2f} s  {result.outcome.value}, final total error {error} {unit} {end.known}"


def event_line(event: Event) -> str:
    """Return one event as a line of text."""
    return f"{event.time_s:6.2f} s  {event.level}: {event.text}"


def step_line(recording: Recording, index: int) -> str:
    """Return one control step as a line of text."""
    step = recording.log.steps[index]
    unit = recording.log.start.setup.unit
    plan, direction, state = step.plan, step.plan.doing, ""
    if (u := step.command.direction) is not None:
        direction = f"{math.degrees(math.remainder(u, math.tau)):+.1f} deg"
        state = "" if plan.state is State.DRIVING else f"  {plan.state}"
    if plan.estimate and (who := plan.estimate.standing(recording.log.start.setup.names)):
        state += f"  {', '.join(who)}: standing"
    time_s = recording.elapsed_s(int(recording.step_ns[index]))
    cost = "      -" if plan.pauses else f"{plan.cost:7.1f}"  # robots that stand follow no plan
    return (
        f"{time_s:6.2f} s  k {step.k:<3}  horizon {len(plan.signals):<3}  "
        f"J {cost} {unit}  total error {recording.totals[index]:7.1f} {unit} measured  "
        f"direction {direction:>10}  evaluations {plan.evaluations:<6}  "
        f"{plan.search.ended}{state}"
    )
