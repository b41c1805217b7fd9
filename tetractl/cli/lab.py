"""`tetractl lab`: checks, calibrates, surveys, stops or emulates a lab."""

import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import partial
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tetractl.cli import ui
from tetractl.cli.options import AsJson, Lab, Sets, Spec, Yes, argument, option, out_option, switch
from tetractl.cli.unread import hung_up_unread
from tetractl.core.errors import Exit, UsageError
from tetractl.core.files import save_whole
from tetractl.lab.serial_port import PortHeldError, stop_beside
from tetractl.run.interrupt import interrupted_once
from tetractl.view.terminal.keys import SAYS, StopKey

if TYPE_CHECKING:
    from tetractl.core.setup import Setup
    from tetractl.experiment.experiment import Experiment
    from tetractl.experiment.lab_section import LabLimits, LabSection, Measured
    from tetractl.lab.actuators.xbee.hardware import XbeeSection
    from tetractl.lab.rig import Rig


def check(
    spec: Spec,
    sets: Sets = None,
    plant: Lab = "lab",
    as_json: AsJson = False,
    yes: Annotated[bool, switch("Answer yes to every question.", "--yes")] = False,
) -> int:
    """Check camera, actuator, robots, batteries and starts of a lab, without moving a robot.

    Exit code 0 means that a run could start now. Questions that only a person can answer, such as
    the firmware of an unknown radio, are asked; without a terminal, give --yes.

    Example: tetractl lab check experiments/three_m3pi_lab.yaml
    """
    from tetractl.experiment.load import load_document
    from tetractl.experiment.plants import on_plant, settings_on
    from tetractl.experiment.yaml.document import read_document
    from tetractl.lab.preflight import look_over
    from tetractl.view.terminal import findings

    document = read_document(spec)
    loaded = load_document(document, settings_on(document, sets or [], plant))
    experiment = on_plant(loaded, plant).experiment
    rig = ui.rig_of(experiment)
    if experiment.open:
        rig.start_anywhere()
    with interrupted_once(robots=True):
        found = look_over(rig)
    if as_json:
        print(dumps(findings.as_json(found), indent=2, allow_nan=False))
    else:
        findings.print_findings(found)
    return Exit.DONE if found.ready and (yes or _agreed(found.questions)) else Exit.FAILED


def _agreed(questions: Sequence[str]) -> bool:
    """Return whether the operator at the terminal answers yes to every question."""
    if questions and not sys.stdin.isatty():
        ui.tell("questions not answered: add --yes if there is no terminal")
        return False
    return all(typer.confirm(question, err=True) for question in questions)


def stop(
    spec: Annotated[
        Path | None, argument("[SPEC]", "Spec file; only its actuator is used.")
    ] = None,
    sets: Sets = None,
    port: Annotated[
        str | None, option("PORT", "Serial port of an m3pi radio, in place of a spec.")
    ] = None,
    baud: Annotated[int, option("N", "With --port: baud rate.")] = 57600,
) -> int:
    """Stop every robot permanently, through the spec's actuator or the port of an m3pi radio.

    m3pi robots stay stopped until they are switched off. No camera is needed. A run that uses the
    port is ended: stops are sent on the same port, the run gets two requests to end, then it is
    killed. Exits with 1 if another program keeps the port.

    Example: tetractl lab stop --port /dev/ttyUSB0
    """
    if (spec is None) == (port is None):
        raise UsageError("give either a SPEC or --port")

    if spec is not None:
        lab, experiment = _lab(spec, sets)
        stop_all = partial(lab.actuator.stop_all, experiment.setup, lab.clock())
    else:
        from tetractl.core.clock import MonotonicClock
        from tetractl.lab.actuators.m3pi import broadcast as m3pi

        stop_all = partial(m3pi.stop_all, _xbee(port or "", baud), MonotonicClock())
    try:
        typer.echo(stop_all())
    except PortHeldError as held:
        stop_beside(held.port, partial(stop_all, alone=False), typer.echo)
        typer.echo(stop_all())
    return Exit.DONE


def calibrate(
    spec: Spec,
    sets: Sets = None,
    plant: Lab = "lab",
    out: Annotated[Path, out_option("FILE", "YAML file to write the calibration to.")] = Path(
        "calibration.yaml"
    ),
    robot: Annotated[
        list[str] | None, option("NAME", "Calibrate only this robot; may be repeated. [all]")
    ] = None,
    limit: Annotated[
        int,
        option(
            "N",
            "Largest output that the calibration sends, in 127ths of full speed; for m3pi robots a "
            "wheel count.",
            min=10,
            max=80,
        ),
    ] = 45,
    yes: Yes = False,
) -> int:
    """Calibrate each robot's actuator by small motions.

    It measures wheel speeds, wheel distance and heading offset of robots on two wheels, and the
    time from a command to the first picture in which they moved. Robots
    move one after another, each within about 0.3 m; space or Esc stops all robots. Enter the file's
    name in the spec as `lab.calibration`.

    Example: tetractl lab calibrate experiments/three_m3pi_lab.yaml -o m3pi.calibration.yaml
    """
    from numpy.random import SeedSequence

    from tetractl.core.protocols import LabSupervision
    from tetractl.experiment.load import load_document
    from tetractl.experiment.plants import on_plant, settings_on
    from tetractl.experiment.yaml.document import read_document
    from tetractl.plant.lab_plant import RigSection

    ui.refuse_existing(out)
    document = read_document(spec)
    loaded = load_document(document, settings_on(document, sets or [], plant))
    experiment = on_plant(loaded, plant).experiment
    lab, setup = experiment.plant, experiment.setup
    assert isinstance(lab, RigSection), "`on_plant` has chosen a lab"
    names = robot or list(setup.names)
    for name in names:
        if name not in setup.names:
            raise UsageError(f"--robot {name}: the spec has no such robot")
    if lab.real_time:
        ui.require_confirmation(yes)
    if lab.real_time and not yes:
        typer.confirm(f"{', '.join(names)} will move up to 0.3 m each. Continue?", abort=True)
    supervision = LabSupervision()

    def rig(limits: "LabLimits", one: "Setup") -> "Rig":
        own, seed = lab.model_copy(update={"limits": limits}), SeedSequence(experiment.trials.seed)
        return own.rig(one, own.clock(), seed, supervision)

    stop_key = StopKey(supervision.emergency.set, lambda: None)
    with hung_up_unread(), interrupted_once(robots=True), stop_key as key:
        if key.listening:
            ui.tell(SAYS)
        found = lab.actuator.calibrate(lab, rig, setup, names, limit, ui.tell)
    return save_calibration(out, found)


def save_calibration(out: Path, found: "Measured") -> int:
    """Write a file for `lab.calibration`, and print what was found; return the exit code."""
    from tetractl.experiment.plants import Calibration
    from tetractl.experiment.yaml.core_yaml import dump

    calibration = Calibration(
        measured=datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"),
        emulated=", ".join(found.emulated) or None,
        camera=dict(found.camera),
        actuator=dict(found.actuator),
    )
    save_whole(out, dump(calibration.model_dump(mode="json", exclude_none=True)).encode())
    print(*found.lines, sep="\n")
    whose = f", of an emulated {' and '.join(found.emulated)}" if found.emulated else ""
    ui.tell(f"wrote {out}{whose}; name it in the spec: lab.calibration")
    return Exit.DONE


def _lab(spec: Path, sets: list[str] | None) -> "tuple[LabSection, Experiment]":
    from tetractl.experiment.plants import lab_of, on_plant

    loaded = ui.load(spec, sets)
    experiment = on_plant(loaded, "lab").experiment
    return lab_of(experiment, loaded.name), experiment


def _xbee(port: str, baud: int) -> "XbeeSection":
    from pydantic import ValidationError

    from tetractl.experiment.explain import words
    from tetractl.lab.actuators.xbee.hardware import XbeeSection

    try:
        return XbeeSection.model_validate({"port": port, "baud": baud})
    except ValidationError as error:
        details = error.errors()[0]
        message = words(details, details["input"])
        raise UsageError(f"--{details['loc'][0]}: {message}") from None
