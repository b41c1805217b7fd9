"""Which plant an experiment is run on, and what a calibration adds to its robots."""

from dataclasses import replace
from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError

from tetractl.core.errors import SpecError
from tetractl.experiment.base import Finite, Model, Name
from tetractl.experiment.consistency import lab_contradictions
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.lab import LabRobot, LabSpec, LabWheel
from tetractl.experiment.load import LoadedSpec, frozen
from tetractl.experiment.plant import SimSpec
from tetractl.experiment.yaml.core_yaml import dump
from tetractl.experiment.yaml.document import parse_document, read_text
from tetractl.experiment.yaml.explain import explain
from tetractl.experiment.yaml.problems import InvalidSpecError, dotted

PlantKind = Literal["sim", "lab"]


class RobotCalibration(Model):
    """What was measured of one robot; see the fields of the same name in the spec's lab."""

    name: Name
    """Name of the robot."""
    heading_offset: Finite
    """Added to the rigid body's heading [rad]."""
    radius_mm: float = Field(gt=0, le=1000, allow_inf_nan=False)
    """Distance r from a wheel to its centre [mm]."""
    left: LabWheel
    """The left wheel."""
    right: LabWheel
    """The right wheel."""
    swap: bool
    """The left wheel hangs on the motor meant for the right."""


class Calibration(Model):
    """What `tetractl lab calibrate` found."""

    measured: str = Field(max_length=100)
    """When it was measured."""
    robots: tuple[RobotCalibration, ...] = Field(min_length=1, max_length=32)
    """The robots measured."""


def on_plant(loaded: LoadedSpec, kind: PlantKind | None) -> LoadedSpec:
    """Return the spec with `plant` being what is really run: `kind`, or what the spec says.

    The lab's calibration file is read here and its values take their places in the spec; its text
    goes with the spec into the log. A `lab` section that is not used stays for another run.
    """
    experiment = loaded.experiment
    if kind == "sim" and isinstance(experiment.plant, LabSpec):
        updated = {"plant": SimSpec(), "lab": experiment.plant}
        return replace(loaded, experiment=experiment.model_copy(update=updated))
    if kind != "lab" and isinstance(experiment.plant, SimSpec):
        return loaded
    lab = lab_of(experiment, loaded.name)
    loaded = replace(loaded, experiment=experiment.model_copy(update={"plant": lab, "lab": None}))
    if lab.calibration is None:
        return loaded
    path = (loaded.path.parent if loaded.path else Path()) / lab.calibration
    text = read_text(path)
    calibrated = apply(lab, parse_calibration(text, str(path)), str(path))
    experiment = loaded.experiment.model_copy(update={"plant": calibrated})
    for loc, message in lab_contradictions(experiment):
        raise SpecError(f"{path}: with this calibration, {dotted(loc)} {message}")
    return replace(loaded, experiment=experiment, attached=((path.name, text),))


def lab_of(experiment: Experiment, name: str) -> LabSpec:
    """Return the lab of an experiment; SpecError where it has none."""
    if isinstance(experiment.plant, LabSpec):
        return experiment.plant
    if experiment.lab is None:
        raise SpecError(
            f"{name}: has no lab", "add a 'lab:' section; experiments/three_m3pi_lab.yaml has one"
        )
    return experiment.lab


def parse_calibration(text: str, origin: str) -> Calibration:
    """Read a calibration file; problems are told as a spec's are."""
    document = parse_document(text, origin)
    try:
        found = Calibration.model_validate(frozen(document.data), strict=True)
    except ValidationError as error:
        raise InvalidSpecError([*document.found, *explain(error, document)]) from None
    if document.found:
        raise InvalidSpecError(document.found)
    return found


def calibration_yaml(calibration: Calibration) -> str:
    """Return the text of a calibration file."""
    return dump(calibration.model_dump(mode="json"))


def apply(lab: LabSpec, calibration: Calibration, origin: str) -> LabSpec:
    """Return the lab with the measured values in place of its robots' own."""
    measured = {robot.name: robot for robot in calibration.robots}
    unknown = sorted(set(measured) - {robot.name for robot in lab.robots})
    if unknown:
        raise SpecError(f"{origin}: {unknown[0]} is no robot of the lab", "calibrate this lab")

    def calibrated(robot: LabRobot) -> LabRobot:
        if robot.name not in measured:
            return robot
        return robot.model_copy(update=dict(measured[robot.name]))

    return lab.model_copy(update={"robots": tuple(map(calibrated, lab.robots))})
