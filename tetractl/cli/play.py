"""`tetractl play`: steer the robots of a spec by hand, and see what its controller does."""

import math
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Annotated

from tetractl.cli import options, ui
from tetractl.cli.trials import RunOptions, load_to_run, new_log_folder, stoppable
from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import Exit, UsageError
from tetractl.tools.table.table import lengths
from tetractl.tools.table.terminal_table import open_console

if TYPE_CHECKING:
    from rich.console import Console

    from tetractl.core.protocols import LabSupervision, Observer
    from tetractl.core.trial import Result
    from tetractl.experiment.experiment import Experiment
    from tetractl.experiment.loaded_spec import LoadedSpec
    from tetractl.run.hand import Ask
    from tetractl.run.interrupt import Interrupt

TRIAL = 0
"""The trial that is steered, and that the controller runs."""
THEIRS = (
    "The controller too sends one direction to all: it simulates many sequences, and sends the "
    "first step of the best. It stops when no sequence brings them nearer."
)
"""What is said when the controller's trial has ended, and its last picture stays."""
UNDISTURBED = (
    "nothing is disturbed in this spec, so the controller knows exactly what robots do; try one "
    "with disturbances, such as experiments/three_m3pi_bench.yaml"
)


def play(
    spec: options.Spec,
    seed: options.Seed = None,
    sets: options.Sets = None,
    plant: Annotated[
        str | None,
        options.plant_option(
            "sim: simulate. lab: drive the robots of the spec's lab. emulated: emulate that lab. "
            "[spec: plant.type]"
        ),
    ] = None,
    speed: Annotated[
        float, options.option("R", "Seconds of the trial per second.", min=0.1, max=100)
    ] = 1.0,
    script: Annotated[
        Path | None,
        options.option("FILE", "Take the keys from lines such as `1.5 up`, in virtual time."),
    ] = None,
    yes: options.Yes = False,
    out: options.LogFolder = None,
) -> int:
    """Steer all robots yourself, by one direction; then the spec's controller does.

    The first arrow key starts the robots. An arrow, or a drag of the mouse, sets the direction to
    which all robots turn; dots show where they go if you hold it. Steer round obstacles (yellow).
    Space stops the robots, which ends the trial. Its error is the sum of the robots' distances to
    their targets.

    After another key the controller steers the same robots, from the same start and with the same
    disturbances, if the spec has any, and its last picture stays until a key is pressed.
    Both trials are logged, in DIR/you and DIR/controller; `verify`, `replay` and `stats` read yours
    as given directions.

    In the lab, and in an emulated one, Esc is the emergency stop. In the lab robots are placed and
    started as by `run`, and the controller's trial is left out.

    Example: tetractl play experiments/three_m3pi.yaml
    """
    from tetractl.control.build import warm_up
    from tetractl.core.plan import Outcome
    from tetractl.experiment.plants import on_plant
    from tetractl.run.open_trial import directed_spec
    from tetractl.view.terminal.hand_keys import read_script

    loaded = on_plant(load_to_run(spec, sets or [], plant, seed=seed), plant)
    directed = directed_spec(loaded)
    experiment = loaded.experiment
    lab = experiment.plant.real_time
    timed_keys = None if script is None else read_script(script)
    console = open_console(stderr=True)
    has_keys = sys.stdin is not None and sys.stdin.isatty()
    has_screen = console.is_terminal and not console.is_dumb_terminal
    if timed_keys is None and not (has_keys and has_screen):
        raise UsageError("play reads keys, and this is no terminal: give --script FILE")
    if lab and (timed_keys is not None or speed != 1.0):
        raise UsageError("--script and --speed are for virtual time: in the lab a person steers")
    if lab:
        ui.require_confirmation(yes)
    folder = out or new_log_folder(experiment.name)
    ui.refuse_existing(folder, folder=True)

    with stoppable(directed, RunOptions(yes=yes), by_keys=timed_keys is None) as interrupt:
        if not lab:
            warm_up(experiment, partial(ui.announce_compiling, False))
        with (
            _by_keys(experiment, console, speed, yes, interrupt)
            if timed_keys is None
            else nullcontext(Hand(timed_keys.ask))
        ) as hand:
            yours = _steered(directed, folder / "you", hand, interrupt)
            aborted = yours is None or yours.outcome is Outcome.ABORTED
            goes_on = not (aborted or lab or interrupt.requested)
            if goes_on:
                hand.hold()  # until a key is pressed
        theirs = None
        if goes_on and not interrupt.requested:
            shown = console if timed_keys is None else None
            assert yours is not None, "an aborted trial is the last"
            you = f"You: {_how_well(yours, experiment)}."
            theirs = _by_controller(loaded, folder / "controller", shown, speed, you, interrupt)
        return _conclude(folder, experiment, yours, theirs, interrupt)


# ---- your trial ----


@dataclass(frozen=True, slots=True)
class Hand:
    """Who steers: what is asked for each direction, who watches, who supervises a lab, and what
    waits between your trial and the controller's."""

    ask: "Ask"
    observers: "Sequence[Observer]" = ()
    supervision: "LabSupervision | None" = None
    hold: Callable[[], None] = lambda: None


@contextmanager
def _by_keys(
    experiment: "Experiment", console: "Console", speed: float, yes: bool, interrupt: "Interrupt"
) -> "Iterator[Hand]":
    """Show a trial on the terminal, and steer it by the terminal's keys, which are restored at the
    end."""
    from tetractl.core.protocols import LabSupervision
    from tetractl.run.hand import AtEnd, WallPace
    from tetractl.view.terminal.hand_keys import HINTS, WHY, HandKeys, task
    from tetractl.view.terminal.keys import StopKey
    from tetractl.view.terminal.live_screen import LabWatch, LiveView, TerminalPrompt

    plant = experiment.plant
    emergency = threading.Event()
    entered = threading.Event()
    keys = HandKeys(ended=lambda: interrupt.requested or emergency.is_set())
    stop = keys.stop if plant.simulated else emergency.set
    hints = HINTS if plant.simulated else ("ESC: EMERGENCY STOP", *HINTS)
    prompt = TerminalPrompt(console, entered) if plant.real_time and not yes else None
    supervision = LabSupervision(
        emergency,
        prompt,
        cancelled=lambda: interrupt.requested,
        signalled=interrupt.request,
    )
    enter = entered.set if plant.real_time else partial(keys.press, "enter")
    aside = task(experiment.setup)
    with StopKey(stop, enter, steer=keys.press), keys:
        if plant.real_time:
            console.print("; ".join(hints), style="bold", highlight=False)
            with LabWatch(
                console, console, experiment.units.length, live=True, hints=hints, aside=aside
            ) as watch:
                yield Hand(keys.ask, [watch], supervision)
        else:
            with LiveView(console, hints=hints, aside=aside, plain=True) as view:

                def tell(result: "Result") -> None:
                    keys.forget()  # before the words are on the screen: a key that answers counts
                    view.say(WHY, "Any key: the controller", f"You: {_error(result, experiment)}")

                observers = [view, WallPace(MonotonicClock(), speed), AtEnd(tell)]
                yield Hand(keys.ask, observers, supervision, keys.await_key)


def _steered(
    directed: "LoadedSpec", folder: Path, hand: Hand, interrupt: "Interrupt"
) -> "Result | None":
    """Run the trial that a person steers; None if no direction was given."""
    from tetractl.run.hand import HandController, run_by_hand

    controller = HandController(directed, TRIAL, hand.ask)
    result = run_by_hand(directed, folder, controller, hand.observers, interrupt, hand.supervision)
    return result if controller.directions else None


# ---- the controller's trial, and the end ----


def _by_controller(
    loaded: "LoadedSpec",
    folder: Path,
    console: "Console | None",
    speed: float,
    you: str,
    interrupt: "Interrupt",
) -> "Result":
    """Run the same trial by the spec's controller; show it on the console, if any, as fast as
    yours, with how well `you` did."""
    from tetractl.run.folder_lock import make_folder
    from tetractl.run.hand import AtEnd, WallPace
    from tetractl.run.spec_trial import run_logged
    from tetractl.view.terminal.hand_keys import HandKeys
    from tetractl.view.terminal.keys import StopKey
    from tetractl.view.terminal.live_screen import LiveView

    make_folder(folder)
    if console is None:
        return run_logged(loaded, folder, TRIAL, (), interrupt)
    keys = HandKeys(ended=lambda: interrupt.requested)
    with (
        StopKey(keys.stop, partial(keys.press, "enter"), steer=keys.press),
        LiveView(console, aside=f"{you} Now the controller, from the same start.") as view,
    ):

        def tell(result: "Result") -> None:
            keys.forget()  # before the words are on the screen: a key that answers counts
            controller = f"The controller: {_how_well(result, loaded.experiment)}."
            view.say(f"{you} {controller} {THEIRS}", "Any key ends")

        observers = [view, WallPace(MonotonicClock(), speed), AtEnd(tell)]
        result = run_logged(loaded, folder, TRIAL, observers, interrupt)
        keys.await_key()
    return result


def _conclude(
    folder: Path,
    experiment: "Experiment",
    yours: "Result | None",
    theirs: "Result | None",
    interrupt: "Interrupt",
) -> int:
    """Print how the trials ended; return the exit code."""
    from tetractl.core.plan import Outcome

    if yours is None:
        folder.rmdir()
        ui.tell(
            "interrupted" if interrupt.requested else "no direction was given; nothing is logged"
        )
        return Exit.INTERRUPTED if interrupt.requested else Exit.DONE
    compared = "" if theirs is None else f", the controller {_how_well(theirs, experiment)}"
    print(f"you {_how_well(yours, experiment)}{compared}", flush=True)
    if theirs is not None and not experiment.plant.disturbed:
        ui.tell(UNDISTURBED)
    you = quote(str(folder / "you"))
    both = you if theirs is None else f"{you} {quote(str(folder / 'controller'))}"
    ui.tell(f"logs in {folder}; look at them with: tetractl replay {both}")
    for result in (yours, theirs):
        if result is not None and result.outcome is Outcome.ABORTED:
            ui.tell(f"error: {result.reason}")
            return Exit.FAILED
    if interrupt.requested:
        ui.tell("interrupted")
        return Exit.INTERRUPTED
    return Exit.DONE


def _how_well(result: "Result", experiment: "Experiment") -> str:
    """Return the total error and the time of a trial, and where robots must not have been."""
    where = [" through an obstacle"] if result.entered_obstacle else []
    where += [" outside the arena"] if result.left_arena else []
    return f"{_error(result, experiment)}{' and'.join(where)}"


def _error(result: "Result", experiment: "Experiment") -> str:
    """Return the total error and the time of a trial."""
    total = result.total_error
    # a hundredth of a millimetre in an arena of 1 m to 10 m: less is no distance of robots
    least = 10.0 ** (math.floor(math.log10(experiment.setup.arena.width)) - 5)
    error = f"< {least:g}" if total < least else lengths(total)(total)
    return f"{error} {experiment.units.length} in {result.duration_s:.0f} s"
