"""The commands `tetractl lab check`, `stop` and `calibrate`."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.cli import ui
from tetractl.cli.options import AsJson, Lab, Sets, Spec, Yes, argument, option, out_option, switch
from tetractl.cli.unread import hang_up_without_reader
from tetractl.core.clock import MonotonicClock
from tetractl.core.errors import Exit, UsageError
from tetractl.lab.port_holder import stop_and_end_holder
from tetractl.lab.serial_port import PortHeldError
from tetractl.run.interrupt import interrupted_once
from tetractl.tools.files import write_atomically
from tetractl.tools.terminal import has_keys
from tetractl.view.terminal.keys import NO_KEY, STOP_HINT, StopKey

if TYPE_CHECKING:
    from tetractl.core.protocols import LabSupervision
    from tetractl.core.setup import Setup
    from tetractl.lab.actuators.xbee.hardware import XbeeSection
    from tetractl.lab.rig import Rig
    from tetractl.spec.experiment import Experiment
    from tetractl.spec.lab_section import LabLimits, Measured
    from tetractl.spec.loaded_spec import LoadedSpec


def check(
    spec: Spec,
    sets: Sets = None,
    plant: Lab = "lab",
    as_json: AsJson = False,
    yes: Annotated[bool, switch("Answer yes to every question.", "--yes")] = False,
) -> int:
    """Check a lab without moving a robot.

    The command checks camera, actuator, robots, batteries and starts. In a real lab, it also
    practises control steps with simulated robots for 3 s while it reads the camera, to measure
    whether this computer plans in time.

    Exit code 0 means that a run could start now. The command asks questions that only a person can
    answer, such as the firmware of an unknown radio. Without a terminal, give --yes.

    Example: tetractl lab check experiments/three_m3pi_lab.yaml
    """
    from tetractl.control.methods.build import warm_up
    from tetractl.lab.preflight import Preflight, inspect_lab
    from tetractl.run.model_changes import LATENCY_FIELD, stated_model
    from tetractl.run.practice import practise
    from tetractl.view.terminal.findings import create_preflight_items, print_findings

    loaded = _load_for_plant(spec, sets, plant)
    experiment = loaded.experiment
    rig = ui.build_rig_of(experiment)
    if experiment.must_choose_robots:
        rig.start_anywhere()

    def with_practice(findings: Preflight) -> Preflight:
        if (
            not experiment.plant.real_time
            or experiment.must_choose_robots
            or findings.camera_rate_hz is None
        ):
            return findings
        warm_up(experiment, partial(ui.announce_compiling, False))
        practice = practise(loaded, rig.clock, rig.measure_silence_ns)
        return practice.add_to(findings, rig.limits)

    with interrupted_once(robots_move=True):
        preflight = inspect_lab(rig, with_practice)
    if as_json:
        print(dumps(create_preflight_items(preflight), indent=2, allow_nan=False))
    else:
        print_findings(preflight, LATENCY_FIELD in stated_model(experiment).delay_fields)
    if not preflight.can_start:
        return Exit.FAILED
    if yes:
        return Exit.DONE
    if preflight.questions and not has_keys():
        ui.print_messages(
            "there is no terminal in which to answer the questions; to answer yes"
            " to all of them, add --yes"
        )
        return Exit.FAILED
    agreed = all(typer.confirm(question, err=True) for question in preflight.questions)
    return Exit.DONE if agreed else Exit.FAILED


def stop(
    spec: Annotated[
        Path | None, argument("[SPEC]", "Spec file. The command reads only its actuator.")
    ] = None,
    sets: Sets = None,
    port: Annotated[
        str | None, option("PORT", "Serial port of an m3pi radio, instead of a spec.")
    ] = None,
    baud: Annotated[int, option("N", "Baud rate of the radio at --port.")] = 57600,
) -> int:
    """Stop every robot, through the spec's actuator or the port of an m3pi radio.

    m3pi and twist robots stay stopped until you switch them off and on. A coil driver makes no
    field until you switch it off and on. Other robots, such as toio cubes, can be driven again at
    once. Cells swim on.

    No camera is needed. If a run uses the port, the command sends stops on the same port and ends
    the run: it asks the run twice to end, and then kills it. Exits with 1 if a robot cannot be
    reached, no radio answers, or another program keeps a port.

    Example: tetractl lab stop --port /dev/ttyUSB0
    """
    stop_all = _find_stop_function(spec, sets, port, baud)
    released = set[str]()  # ports of runs that have been ended
    while True:  # until stops are sent while no other program can drive the robots
        try:
            description = stop_all()
        except PortHeldError as held:
            if held.port in released:
                raise
            stop_and_end_holder(held.port, partial(stop_all, alone=False), ui.print_messages)
            released.add(held.port)
        else:
            typer.echo(description)
            return Exit.DONE


def _find_stop_function(
    spec: Path | None, sets: list[str] | None, port: str | None, baud: int
) -> Callable[..., str]:
    """Find the function that stops every robot of a lab, and describes the result in a line.

    The function uses the actuator of a spec's lab, or an m3pi radio on a port.
    """
    if spec is not None and port is None:
        return _find_spec_stop_function(spec, sets or [])
    if port is not None and spec is None:
        from tetractl.lab.actuators.m3pi import broadcast as m3pi

        return partial(m3pi.stop_in_range, _xbee(port, baud), MonotonicClock())
    raise UsageError("give either a spec or --port, and only one of them")


def _find_spec_stop_function(spec: Path, sets: list[str]) -> Callable[..., str]:
    """Find the function that stops every robot of a spec's real lab, without its calibration.

    If another part of the spec is wrong, the robots are stopped by its actuator alone, and the
    errors are printed as warnings.
    """
    from tetractl.spec.actuator_alone import load_actuator_alone
    from tetractl.spec.load import load_document
    from tetractl.spec.plants import adapt_settings, get_lab, select_plant
    from tetractl.spec.yaml.document import read_document
    from tetractl.spec.yaml.settings import with_settings

    document = read_document(spec)
    settings = adapt_settings(document, sets, "lab")
    try:
        loaded = select_plant(load_document(document, settings), "lab", with_calibration=False)
    except UsageError as error:
        document_with_settings = with_settings(document, settings)
        actuator_and_setup = load_actuator_alone(document_with_settings)
        # it may name the port
        wrong_setting = len(document_with_settings.problems) > len(document.problems)
        if actuator_and_setup is None or wrong_setting:
            raise
        ui.print_messages(*(f"warning: {line}" for line in error.message.split("\n")))
        actuator, setup = actuator_and_setup
        return partial(actuator.stop_all, setup, MonotonicClock())
    lab = get_lab(loaded.experiment, loaded.name)
    return partial(lab.actuator.stop_all, loaded.experiment.setup, lab.clock())


def calibrate(
    spec: Spec,
    sets: Sets = None,
    plant: Lab = "lab",
    out: Annotated[Path, out_option("FILE", "YAML file to write the calibration to.")] = Path(
        "calibration.yaml"
    ),
    robot: Annotated[
        list[str] | None, option("NAME", "Calibrate only this robot. Can be repeated. [all]")
    ] = None,
    limit: Annotated[
        int,
        option(
            "N",
            "Maximum motor output during the calibration, where 127 is full speed.",
            min=10,
            max=80,
        ),
    ] = 45,
    yes: Yes = False,
) -> int:
    """Calibrate each robot's actuator with small motions.

    The command measures wheel speeds, wheel distance and heading offset of robots on two wheels.
    The robots move one after another, each within about 0.3 m. Space or Esc stops all robots.
    Afterwards, enter the name of the file in the spec as `lab.calibration`.

    Example: tetractl lab calibrate experiments/three_m3pi_lab.yaml -o m3pi.calibration.yaml
    """
    ui.refuse_existing(out)
    experiment = _load_for_plant(spec, sets, plant).experiment
    names = robot or list(experiment.setup.names)
    for name in names:
        if name not in experiment.setup.names:
            raise UsageError(f"--robot {name}: the spec has no robot with this name")
    ui.find_rig_section(experiment).require_calibratable()
    if experiment.plant.real_time:
        ui.require_consent(yes, f"{', '.join(names)} will move by up to 0.3 m each.")
    return save_calibration(out, _calibrate_robots(experiment, names, limit))


def _calibrate_robots(experiment: "Experiment", names: Sequence[str], limit: int) -> "Measured":
    """Calibrate the named robots with small motions, and return the measured values.

    A signal, or the terminal's space bar or Esc, stops the robots.
    """
    from numpy.random import SeedSequence

    from tetractl.core.protocols import LabSupervision

    lab = ui.find_rig_section(experiment)
    supervision = LabSupervision()

    def make_rig(limits: "LabLimits", setup: "Setup") -> "Rig":
        limited = lab.model_copy(update={"limits": limits})
        seed = SeedSequence(experiment.trials.seed)
        return limited.rig(setup, limited.clock(), seed, supervision)

    with watched_by_operator(supervision, experiment.plant.real_time):
        calibrate_robots = lab.actuator.calibrate
        return calibrate_robots(lab, make_rig, experiment.setup, names, limit, ui.print_messages)


@contextmanager
def watched_by_operator(supervision: "LabSupervision", real_robots: bool) -> Iterator[None]:
    """Let the operator stop all robots by the space bar or Esc, and let a signal end the work.

    These keys are printed. If real robots move without a terminal, a line says that there is no
    such key.
    """
    stop_key = StopKey(supervision.emergency.set, lambda: None)
    with hang_up_without_reader(), interrupted_once(robots_move=True), stop_key as key:
        if key.listening:
            ui.print_messages(STOP_HINT)
        elif real_robots:
            ui.print_messages(NO_KEY)
        yield


def save_calibration(out: Path, measured: "Measured") -> int:
    """Write measured values to a calibration file, print them, and return the exit code."""
    from tetractl.spec.plants import Calibration
    from tetractl.spec.yaml.core_yaml import format_yaml

    calibration = Calibration(
        measured=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        emulated=", ".join(measured.emulated) or None,
        camera=dict(measured.camera),
        actuator=dict(measured.actuator),
    )
    try:  # first, so that a full disk does not lose the lines
        print(*measured.lines, sep="\n", flush=True)
    except OSError:  # the reader of stdout has ended, or its disk is full
        ui.print_messages(*measured.lines)
    values = calibration.model_dump(mode="json", exclude_none=True)
    write_atomically(out, format_yaml(values).encode())
    emulated_note = (
        f", of an emulated {' and '.join(measured.emulated)}" if measured.emulated else ""
    )
    ui.print_messages(
        f"wrote {out}{emulated_note}; to use it, name the file in the spec as lab.calibration"
    )
    return Exit.DONE


def _load_for_plant(spec: Path, sets: list[str] | None, plant: str) -> "LoadedSpec":
    """Load a spec for its lab, which is real or, if `plant` says so, emulated by software."""
    from tetractl.spec.load import load_document
    from tetractl.spec.plants import adapt_settings, select_plant
    from tetractl.spec.yaml.document import read_document

    document = read_document(spec)
    loaded = load_document(document, adapt_settings(document, sets or [], plant))
    return select_plant(loaded, plant)


def _xbee(port: str, baud: int) -> "XbeeSection":
    """Return the section of the XBee radio that the options --port and --baud describe.

    Raises:
        UsageError: If a value is wrong.
    """
    from pydantic import ValidationError

    from tetractl.lab.actuators.xbee.hardware import XbeeSection
    from tetractl.spec.explain_errors import explain_in_words

    try:
        return XbeeSection.model_validate({"port": port, "baud": baud})
    except ValidationError as error:
        problem = error.errors()[0]
        message = explain_in_words(problem, problem["input"])
        raise UsageError(f"--{problem['loc'][0]}: {message}") from None
