"""`tetractl play`: steer the robots of a spec by hand, and see what its controller does.

    _on_terminal    a simulation: you steer as often as you want, and the controller once
    _in_lab         the robots of a lab: you steer once

With a file of keys, you steer once, and then the controller does.
"""

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

from tetractl.cli import options, ui
from tetractl.cli.trials import RunOptions, load_to_run, new_log_folder, stop_on_signals
from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import Exit, UsageError
from tetractl.tools.table.table import create_length_format
from tetractl.tools.table.terminal_table import open_console
from tetractl.tools.terminal import has_keys

if TYPE_CHECKING:
    from rich.console import Console

    from tetractl.core.plan import Plan
    from tetractl.core.protocols import LabSupervision, Observer, PlacementPrompt
    from tetractl.core.trial import Result
    from tetractl.run.hand import Ask, Pause
    from tetractl.run.interrupt import Interrupt
    from tetractl.spec.experiment import Experiment
    from tetractl.spec.loaded_spec import LoadedSpec
    from tetractl.view.terminal.hand_keys import HandKeys
    from tetractl.view.terminal.live_screen import LiveView

TRIAL = 0
"""The trial that is steered, and that the controller runs."""
CONTROLLER_NOTE = (
    "The controller also sends one direction to all robots. It simulates many sequences of "
    "directions, and sends the first direction of the best sequence. It stops when no "
    "sequence brings the robots nearer to their targets."
)
"""Text shown when the controller's trial has ended, and its last image stays."""
DISTURBED_EXAMPLE = "three_m3pi_bench"
"""A shipped spec whose robots and camera are disturbed."""


def play(
    spec: options.Spec,
    seed: options.Seed = None,
    sets: options.Sets = None,
    plant: Annotated[
        str | None,
        options.plant_option(
            "sim: simulate. lab: drive the robots of the spec's lab. emulated: emulate this "
            "lab. [spec: plant.type]"
        ),
    ] = None,
    speed: Annotated[
        float | None,
        options.option(
            "R", "Speed of play: seconds of the trial per real second. [1]", min=0.1, max=100
        ),
    ] = None,
    script: Annotated[
        Path | None,
        options.option(
            "FILE",
            "Read the keys from a file instead of the keyboard, and run as fast as "
            "possible. For example, the line `1.5 up` presses the key up after 1.5 s.",
        ),
    ] = None,
    html: Annotated[
        Path | None,
        options.option("FILE", "Only write a web page in which anybody can play."),
    ] = None,
    yes: options.Yes = False,
    out: options.LogFolder = None,
) -> int:
    """Steer all robots yourself with one direction, then let the spec's controller try.

    The first arrow key starts the robots. An arrow, or a drag of the mouse, sets the direction to
    which all robots turn; dots show where that leads. Steer around obstacles (yellow). Space stops
    the robots, which ends the trial. The error of the trial is the sum of the robots' distances to
    their targets.

    Afterwards, Enter lets the controller steer the same robots from the same start, with the same
    disturbances if the spec has any. R lets you try again. Your trials are logged in DIR/you,
    DIR/you-2 and so on, and the controller's trial in DIR/controller. `verify`, `replay` and
    `stats` treat your trials as given directions.

    In the lab, and in an emulated lab, Esc is the emergency stop. In the lab, robots are placed and
    started in the same way as by `run`, and the controller does not steer afterwards.

    With --html, the command only writes a page for a browser, for example for a phone, a class or a
    website. The page needs no network. Its robots move without the spec's disturbances.

    Example: tetractl play experiments/three_m3pi.yaml
    """
    from tetractl.control.methods.build import warm_up
    from tetractl.run.folder_lock import locked
    from tetractl.run.open_trial import directed_spec
    from tetractl.spec.yaml.settings import FieldValue
    from tetractl.view.terminal.hand_keys import read_key_script
    from tetractl.view.terminal.screen import can_show_screens

    loaded = load_to_run(spec, sets or [], plant, [FieldValue("trials.seed", seed, "--seed")])
    if html is not None:
        if script is not None or speed is not None or out is not None:
            raise UsageError(
                "--html writes a page, and cannot be combined with --script, --speed or --out"
            )
        return _write_page(loaded, html)
    directed = directed_spec(loaded)
    experiment = loaded.experiment
    in_lab = experiment.plant.real_time
    timed_keys = None if script is None else read_key_script(script)
    console = open_console(stderr=True)
    if timed_keys is None and not (has_keys() and can_show_screens(console)):
        raise UsageError(
            "play reads keys from a terminal with UTF-8, and there is none here",
            "in a cell of a notebook or without a terminal, give the keys in a file with "
            "--script FILE",
        )
    if in_lab and (timed_keys is not None or speed is not None):
        raise UsageError(
            "--script and --speed work only in virtual time: in the lab, a person steers"
        )
    if timed_keys is not None and speed is not None:
        raise UsageError(
            "--speed cannot be combined with --script, which always runs as fast as possible"
        )
    if in_lab:
        ui.require_yes_or_terminal(yes)
    folder = out or new_log_folder(experiment.name)
    ui.refuse_filled(folder)

    with (
        stop_on_signals(directed, RunOptions(yes=yes), by_keys=timed_keys is None) as interrupt,
        locked(folder),
    ):
        game = Game(loaded, directed, folder, interrupt)
        if in_lab:
            _play_in_lab(game, console, ask_to_place=not yes)
        else:
            warm_up(experiment, partial(ui.announce_compiling, False))
            if timed_keys is None:
                _play_on_terminal(game, console, speed or 1.0)
            else:
                game.steer(timed_keys.ask)
                if not game.over:
                    game.control()
    return _conclude(game)


def _write_page(spec: "LoadedSpec", file: Path) -> int:
    """Write the game as a web page, and return the exit code."""
    from tetractl.api.drawings import play_page

    play_page(spec, file=file)
    ui.print_messages(f"wrote {file}: open it in a browser, or send it to others")
    return Exit.DONE


class Game:
    """The trials of one `play`: those of the person, and one of the controller.

    All trials of the person begin in the same way. A trial that an emulated lab's guard stops is a
    lost try, and the game goes on. The game is over once a trial was interrupted or had no
    direction, or once real robots or an emergency stop ended it.

    Args:
        loaded: The spec, with its controller.
        directed: The same spec for a person who steers.
        folder: Folder for the logs.
        interrupt: Requests to end.

    Attributes:
        yours: Results of the person's trials in which a direction was given.
        theirs: Result of the controller's trial. None before it.
        over: Whether the game has ended.
        error: Why real robots or an emergency stop ended it. Empty otherwise.
    """

    def __init__(
        self, loaded: "LoadedSpec", directed: "LoadedSpec", folder: Path, interrupt: "Interrupt"
    ) -> None:
        self.experiment = loaded.experiment
        self.folder = folder
        self.interrupt = interrupt
        self.own_results: list[Result] = []
        self.controller_result: Result | None = None
        self.over = False
        self.error = ""
        self._loaded = loaded
        self._directed = directed

    def steer(
        self,
        ask: "Ask",
        observers: "Sequence[Observer]" = (),
        supervision: "LabSupervision | None" = None,
        pause: "Pause | None" = None,
    ) -> None:
        """Run a trial that the person steers.

        Args:
            ask: Asks the person for directions.
            observers: Observers that watch the trial.
            supervision: How people supervise the run. None if the robots are simulated.
            pause: Lets the person pause the trial. None if nobody can.
        """
        from tetractl.run.hand import HandController, never_pause, run_by_hand

        folder = self._folder(len(self.own_results) + 1)
        hand = HandController(self._directed, TRIAL, ask, pause or never_pause)
        result = run_by_hand(self._directed, folder, hand, observers, self.interrupt, supervision)
        if hand.directions:
            self.own_results.append(result)
        else:
            self.over = True
        stopped = supervision is not None and supervision.emergency.is_set()
        self._note_end(result, lost=self.experiment.plant.real_time or stopped or self.over)

    def supervision(
        self, emergency: threading.Event, prompt: "PlacementPrompt | None" = None
    ) -> "LabSupervision":
        """Return how the person who plays supervises the robots of a lab; see `LabSupervision`."""
        from tetractl.core.protocols import LabSupervision

        return LabSupervision(
            emergency,
            prompt,
            cancelled=lambda: self.interrupt.requested,
            signalled=self.interrupt.request,
        )

    def control(self, observers: "Sequence[Observer]" = ()) -> None:
        """Run the trial in which the spec's controller steers."""
        from tetractl.run.logged_trial import run_logged
        from tetractl.tools.files import make_folder

        folder = self.folder / "controller"
        make_folder(folder)
        self.controller_result = run_logged(self._loaded, folder, TRIAL, observers, self.interrupt)
        self._note_end(self.controller_result, lost=False)

    @property
    def folders(self) -> "list[Path]":
        """The folders with the logs of the person's trials and of the controller's."""
        numbers = range(1, len(self.own_results) + 1)
        controller_folders = [] if self.controller_result is None else [self.folder / "controller"]
        return [*map(self._folder, numbers), *controller_folders]

    def _folder(self, number: int) -> Path:
        return self.folder / ("you" if number == 1 else f"you-{number}")

    def _note_end(self, result: "Result", lost: bool) -> None:
        """Note how a trial ended. If it was aborted and the game is `lost`, the end is an error."""
        if lost and _is_aborted(result):
            self.over = True
            self.error = result.reason
        if self.interrupt.requested:
            self.over = True


# ---- at a terminal ----


def _play_in_lab(game: Game, console: "Console", ask_to_place: bool) -> None:
    """Let a person steer the robots of a lab once, by keys of the terminal."""
    from tetractl.view.terminal.hand_keys import LAB_HINTS, HandKeys, describe_task
    from tetractl.view.terminal.keys import StopKey
    from tetractl.view.terminal.live_screen import LabView, TerminalPrompt

    experiment = game.experiment
    interrupt = game.interrupt
    emergency = threading.Event()
    entered = threading.Event()
    keys = HandKeys(has_ended=lambda: interrupt.requested or emergency.is_set())
    prompt = TerminalPrompt(console, entered) if ask_to_place else None
    watch = LabView(
        console,
        console,
        experiment.units.length,
        live=True,
        hints=LAB_HINTS,
        side_text=describe_task(experiment.setup, disturbed=True),
    )
    with StopKey(emergency.set, entered.set, steer=keys.press), keys:
        console.print("; ".join(LAB_HINTS), style="bold", highlight=False)
        with watch:
            game.steer(keys.ask, [watch], game.supervision(emergency, prompt))


def _play_on_terminal(game: Game, console: "Console", speed: float) -> None:
    """Let a person steer simulated robots by keys, repeatedly, and the controller once."""
    from tetractl.view.terminal.hand_keys import CONTINUE_KEY, REPEAT_KEY

    pressed_key = _run_own_trial(game, console, speed)
    while not game.over:
        if pressed_key == REPEAT_KEY:
            pressed_key = _run_own_trial(game, console, speed)
        elif pressed_key == CONTINUE_KEY and game.controller_result is None:
            pressed_key = _run_controller_trial(game, console, speed)
        else:
            return


def _run_own_trial(game: Game, console: "Console", speed: float) -> str:
    """Run and show a trial that the person steers. Return the key that was pressed at its end."""
    from tetractl.view.terminal.hand_keys import (
        HINTS,
        LAB_HINTS,
        PAUSED_TEXT,
        WHY_HARD_TEXT,
        HandKeys,
        describe_task,
    )
    from tetractl.view.terminal.live_screen import LiveView

    interrupt = game.interrupt
    simulated = game.experiment.plant.simulated
    emergency = threading.Event()
    keys = HandKeys(lambda: interrupt.requested or emergency.is_set(), can_pause=simulated)
    hints = HINTS if simulated else LAB_HINTS
    side_text = describe_task(
        game.experiment.setup, game.experiment.plant.disturbed or not simulated
    )
    view = LiveView(console, hints=hints, side_text=side_text, steered_by_hand=True)
    stop = keys.stop if simulated else emergency.set

    def pause(plan_of: "Callable[[float], Plan]") -> None:
        if keys.pauses:
            view.show_text(PAUSED_TEXT, "arrows: try", "P: go on")
            keys.await_end_of_pause(lambda direction: view.preview(plan_of(direction), direction))
            view.show_text(side_text, *hints)

    def say_at_end(result: "Result") -> None:
        own_result = f"You: {_describe_result(result, game.experiment)}"
        if _is_aborted(result):
            own_result = f"{own_result}. This try is lost"
        if game.controller_result is None:
            view.show_text(f"{own_result}. {WHY_HARD_TEXT}", "ENTER: the controller", "R: again")
        else:
            view.show_text(
                f"{own_result}. Before: {_summarise_game(game)}.", "R: again", "ENTER: end"
            )

    with _open_screen_with_keys(keys, view, stop):
        observers = _build_observers(view, keys, speed, say_at_end)
        game.steer(keys.ask, observers, game.supervision(emergency), pause)
        return "" if game.over else keys.await_answer()


def _run_controller_trial(game: Game, console: "Console", speed: float) -> str:
    """Run and show the controller's trial. Return the key that was pressed at its end."""
    from tetractl.view.terminal.hand_keys import HandKeys
    from tetractl.view.terminal.live_screen import LiveView

    own_result = f"Your best: {_describe_result(_find_best(game.own_results), game.experiment)}."
    keys = HandKeys(has_ended=lambda: game.interrupt.requested)
    side_text = (
        f"{own_result} Now the controller steers from the same start. The dots show its plan, "
        "which it makes again at each step."
    )
    view = LiveView(console, side_text=side_text, steered_by_hand=True)

    def say_at_end(result: "Result") -> None:
        controller_result = f"The controller: {_describe_result(result, game.experiment)}."
        view.show_text(
            f"{own_result} {controller_result} {CONTROLLER_NOTE}", "R: steer again", "ENTER: end"
        )

    with _open_screen_with_keys(keys, view, keys.stop):
        game.control(_build_observers(view, keys, speed, say_at_end))
        return "" if game.over else keys.await_answer()


@contextmanager
def _open_screen_with_keys(
    keys: "HandKeys", view: "LiveView", stop: Callable[[], None]
) -> "Iterator[None]":
    """Show a view on the terminal during the `with` block, and read keys for the person who steers.

    Esc and a closed terminal call `stop`.
    """
    from tetractl.view.terminal.keys import StopKey

    with StopKey(stop, partial(keys.press, "enter"), steer=keys.press), keys, view:
        yield


def _build_observers(
    view: "LiveView", keys: "HandKeys", speed: float, say_at_end: "Callable[[Result], None]"
) -> "Sequence[Observer]":
    """Return observers that show a trial at `speed` times the wall clock, and report its end."""
    from tetractl.run.hand import EndNotifier, WallPace

    def at_end(result: "Result") -> None:
        keys.forget_answer()  # before the words are on the screen: a key that answers counts
        say_at_end(result)

    return [view, WallPace(MonotonicClock(), speed), EndNotifier(at_end)]


# ---- what is said ----


def _conclude(game: Game) -> int:
    """Print how the trials of the game ended, and return the exit code."""
    if game.own_results:
        print(_summarise_game(game), flush=True)
        if game.controller_result is not None:
            ui.print_messages(*_suggest_disturbances(game.experiment))
        folders = " ".join(quote(str(path)) for path in game.folders)
        ui.print_messages(
            f"the logs are in {game.folder}; look at them with:", f"  tetractl replay {folders}"
        )
    else:
        game.folder.rmdir()
    if game.error:
        ui.print_messages(f"error: {game.error}")
        return Exit.FAILED
    if game.interrupt.requested:
        ui.print_messages("interrupted")
        return Exit.INTERRUPTED
    if not game.own_results:
        ui.print_messages("no direction was given, so nothing was logged")
    return Exit.DONE


def _suggest_disturbances(experiment: "Experiment") -> list[str]:
    """Return lines that suggest a spec with disturbances, if this one simulates none."""
    from tetractl.spec.examples import FOLDER

    if experiment.plant.disturbed or not experiment.plant.simulated:
        return []
    path = Path(FOLDER, f"{DISTURBED_EXAMPLE}.yaml")
    init_command = [] if path.exists() else [f"  tetractl init --example {DISTURBED_EXAMPLE}"]
    return [
        "this spec simulates no disturbances; this command writes a spec with disturbances:",
        *init_command,
        f"  tetractl play {path}",
    ]


def _summarise_game(game: Game) -> str:
    """Describe in one line how well the person's and the controller's trials ended."""
    first_try, *later_tries = [
        _describe_result(result, game.experiment) for result in game.own_results
    ]
    clauses = [f"you {first_try}", *(f"again {other_summary}" for other_summary in later_tries)]
    if game.controller_result is not None:
        clauses.append(
            f"the controller {_describe_result(game.controller_result, game.experiment)}"
        )
    return ", ".join(clauses)


def _is_aborted(result: "Result") -> bool:
    """Check whether a trial was ended by a guard or a fault."""
    return result.outcome == "aborted"


def _find_best(results: "Sequence[Result]") -> "Result":
    """Return the result with the smallest error. Results with lost robots come last."""
    completed = [r for r in results if not (r.entered_obstacle or r.left_arena or _is_aborted(r))]
    return min(completed or results, key=lambda result: result.total_error)


def _describe_result(result: "Result", experiment: "Experiment") -> str:
    """Describe a trial's total error and time, and which robots were where they must not be.

    For an aborted trial, describe when and why the robots were stopped.
    """
    if _is_aborted(result):
        return f"stopped after {result.duration_s:.1f} s ({result.reason})"
    violations = [" through an obstacle"] if result.entered_obstacle else []
    violations += [" outside the arena"] if result.left_arena else []
    return f"{_describe_error(result, experiment)}{' and'.join(violations)}"


def _describe_error(result: "Result", experiment: "Experiment") -> str:
    """Describe the total error and the time of a trial."""
    total_error = result.total_error
    # a hundredth of a millimetre in an arena of 1 m to 10 m: less is no distance of robots
    resolution = 10.0 ** (math.floor(math.log10(experiment.setup.arena.width)) - 5)
    if total_error < resolution:
        error_text = f"< {resolution:g}"
    else:
        error_text = create_length_format(total_error)(total_error)
    return f"{error_text} {experiment.units.length} in {result.duration_s:.0f} s"
