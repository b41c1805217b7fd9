"""Plays recorded trials on the terminal's alternate screen, controlled by keys.

Without a terminal, it prints a line for each control step and event.
"""

import math
from collections.abc import Callable
from operator import itemgetter

from rich.console import Console, ConsoleOptions, RenderResult
from rich.text import Text

from tetractl.core.clock import Clock
from tetractl.core.plan import State
from tetractl.tools.table.table import create_length_format
from tetractl.view.plan_words import describe_activity, describe_search_end
from tetractl.view.player import Playback, Player, Recording
from tetractl.view.terminal.dashboard import Dashboard, Footer, fill_rows, fit_line
from tetractl.view.terminal.keys import Keyboard
from tetractl.view.terminal.screen import Screen

SPACE_ACTIONS = {Playback.PLAYING: "pause", Playback.PAUSED: "play ", Playback.ENDED: "again"}
"""What the space bar does, by the player's state."""
TRIAL_STEP_BY_KEY = {"n": 1, "p": -1}
"""Keys that select another trial, and by how many trials each moves on."""
KEY_HELP = {
    "space": "pause or continue; at the end: play again from the start",
    "←→": "1 s back or forward",
    ", .": "previous or next control step, and pause",
    "E e": "previous or next event, and pause",
    "Home End": "start or end",
    "+ -": "double or halve the rate",
    "p n": "previous or next trial, if several logs are given",
    "?": "show or hide this list",
    "q": "quit",
}
"""What each key does, as the help shows it."""
KEY_WAIT_S = 1 / 15
"""Maximum time to wait for a key before the next image is due [s]."""


def play_trials(
    console: Console,
    player: Player,
    count: int = 1,
    select_trial: Callable[[int, Player], Player] | None = None,
) -> bool:
    """Play recorded trials until q is pressed, beginning with the first.

    The keys n and p go to the next and the previous trial.

    Args:
        console: The console.
        player: The player of the first trial.
        count: Number of trials.
        select_trial: Returns the player of trial i, which continues like the present player. None
            to play only the first.

    Returns:
        Whether a signal ended the play.
    """
    index = 0
    is_help_shown = False
    drawn_state = None
    screen = Screen(console)
    # the keyboard is the outer context: no signal interrupts before the screen is restored
    with Keyboard(on_leave=screen.close, on_return=screen.open) as keyboard, screen:
        while player.state is not Playback.QUIT:
            player.update()
            # what a picture depends on: while it is the same, nothing is drawn
            displayed_state = (
                index,
                player.now_ns,
                player.rate,
                player.state,
                console.size,
                is_help_shown,
            )
            if displayed_state != drawn_state:
                screen.show(KeyHelp() if is_help_shown else create_dashboard(player, index, count))
                drawn_state = displayed_state
            for key in keyboard.read(KEY_WAIT_S):
                next_index = index + TRIAL_STEP_BY_KEY.get(key, 0)
                if select_trial and next_index != index and 0 <= next_index < count:
                    index = next_index
                    player = select_trial(index, player)
                is_help_shown = key == "?" and not is_help_shown
                player.press(key)
    return keyboard.interrupted


def create_dashboard(player: Player, index: int = 0, count: int = 1) -> Dashboard:
    """Create the dashboard that shows a recorded trial at the player's present time.

    Args:
        player: The player.
        index: Index of the trial.
        count: Number of trials that are played.
    """
    recording = player.recording
    log = recording.log
    trial_position = f" ({index + 1} of {count})" if count > 1 else ""
    return Dashboard(
        recording.moment_at(player.now_ns),
        heading=f"{log.start.setup.name}, trial {log.start.trial}{trial_position}",
        footer=_footer(player, has_next=index + 1 < count),
        notes=("damaged log", *log.damage.lost) if log.damage else (),
    )


def _footer(player: Player, has_next: bool) -> Footer:
    """Return the lowest line: the playing speed, the time, and the keys, the most useful first."""
    recording = player.recording
    sign = "▶" if player.state is Playback.PLAYING else "‖"
    now_s = recording.log.elapsed_s(player.now_ns)
    end_s = recording.log.elapsed_s(recording.end_ns)
    end_text = f"{end_s:.1f}"
    hints = [f"space {SPACE_ACTIONS.get(player.state, '')}", "? keys", "q quit"]
    if has_next:
        hints.append("n next trial")
    hints += ["←→ ±1 s", ". step", "e event", "+/- rate"]
    return Footer(
        left_text=f"{sign} {player.rate:g}×",
        fraction=now_s / end_s if end_s > 0 else 1.0,
        right_text=f"{now_s:{len(end_text)}.1f} / {end_text} s",
        hints=tuple(hints),
    )


class KeyHelp:
    """A list of the player's keys, which fills the space available; the library rich prints it."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width = options.max_width
        height = options.height or console.height
        key_width = max(len(key) for key in KEY_HELP)
        title = [Text("Keys of the player", "bold"), Text()]
        lines = title if height > len(KEY_HELP) + len(title) else []
        for key, action in KEY_HELP.items():
            lines.append(Text.assemble((f" {key:<{key_width}}", "bold"), f"  {action}"))
        while len(lines) < height:
            lines.append(Text())
        lines = lines[:height]
        yield from fill_rows([fit_line(console, line, width) for line in lines], width)


def print_lines(
    recording: Recording,
    wall: Clock,
    span: tuple[int, int],
    *,
    rate: float | None = None,
    loop: bool = False,
) -> None:
    """Print the control steps and events of a recording, in the order of their times.

    Args:
        recording: The recording.
        wall: The wall clock.
        span: The first and last time to print [ns].
        rate: Speed of the lines, relative to the trial. None to print them at once or, with `loop`,
            at the trial's speed.
        loop: Whether to start again at the end.
    """
    start_ns, until_ns = span
    speed = rate or 1.0
    waits = loop or rate is not None
    lines = _lines(recording, start_ns, until_ns)
    while True:
        began_ns = wall.now()
        for time_ns, line in lines:
            if waits:
                wall.sleep_until(began_ns + math.ceil((time_ns - start_ns) / speed))
            print(line, flush=waits)
        if not loop or not lines:
            return
        wall.sleep_until(began_ns + math.ceil((until_ns - start_ns) / speed))


def _lines(recording: Recording, start_ns: int, until_ns: int) -> list[tuple[int, str]]:
    """Return the lines to print for steps and events, each after its time [ns], in order.

    At the same time, a step comes before events, and the result comes last.
    """
    lines = [
        (step_ns, format_step(recording, index))
        for index, step_ns in enumerate(recording.step_ns.tolist())
    ]
    lines += [
        (event_ns, f"{event.time_s:6.2f} s  {event.level}: {event.text}")
        for event_ns, event in zip(recording.event_ns.tolist(), recording.events, strict=True)
    ]
    lines.sort(key=itemgetter(0))
    if recording.log.result is not None:
        lines.append((recording.end_ns, format_result(recording)))
    return [(time_ns, line) for time_ns, line in lines if start_ns <= time_ns <= until_ns]


def format_result(recording: Recording) -> str:
    """Return a line of text that says how a trial ended, with its final error.

    It must have a result.
    """
    final_moment = recording.moment_at(recording.end_ns)
    result = recording.log.result
    assert result is not None, "the caller has checked this"
    unit = recording.log.start.setup.unit
    error = create_length_format(result.total_error)(result.total_error)
    time_s = recording.log.elapsed_s(recording.end_ns)
    final_error = f"final total error {error} {unit} {final_moment.pose_kind}"
    return f"{time_s:6.2f} s  {result.outcome.value}, {final_error}"


def format_step(recording: Recording, index: int) -> str:
    """Return a line of text about the control step of a recording with this index, from 0."""
    setup = recording.log.start.setup
    step = recording.log.steps[index]
    plan = step.plan
    direction = describe_activity(plan)
    state = ""
    if step.command.direction is not None:
        degrees = math.degrees(math.remainder(step.command.direction, math.tau))
        direction = f"{degrees:+.1f} deg"
        state = "" if plan.state is State.DRIVING else f"  {plan.state}"
    standing = plan.estimate.list_standing(setup.names) if plan.estimate else []
    if standing:
        state += f"  {', '.join(standing)}: standing"
    time_s = recording.log.elapsed_s(int(recording.step_ns[index]))
    cost = "      -" if plan.pauses else f"{plan.cost:7.1f}"  # robots that stand follow no plan
    return (
        f"{time_s:6.2f} s  k {step.k:<3}  horizon {len(plan.signals):<3}  "
        f"J {cost} {setup.unit}  total error {recording.totals[index]:7.1f} {setup.unit} measured  "
        f"direction {direction:>10}  evaluations {plan.evaluations:<6}  "
        f"{describe_search_end(plan.search)}{state}"
    )
