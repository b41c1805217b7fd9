"""Selects the plant of an experiment, and applies a calibration file to its lab."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError

from tetractl.core.commands import VIRTUAL_LAB
from tetractl.core.errors import SpecError, printable
from tetractl.core.registries import PLANTS
from tetractl.experiment.base import Model
from tetractl.experiment.consistency import section_contradictions
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.lab_section import LabSection
from tetractl.experiment.load import LoadedSpec, attach
from tetractl.experiment.registry_fields import STRICT, KindSection
from tetractl.experiment.yaml.core_yaml import dump
from tetractl.experiment.yaml.document import Document, Place, frozen, parse_document, read_text
from tetractl.experiment.yaml.explain import explain, validated
from tetractl.experiment.yaml.problems import InvalidSpecError, Loc, dotted

PlantKind = Literal["sim", "lab", "emulated"]


class Calibration(Model):
    """The result of `tetractl lab calibrate`: values for the lab's sections."""

    measured: str = Field(max_length=100)
    """Date and time of the measurement."""
    camera: dict[str, Any] = Field(default={})
    """Values that replace values in `lab.camera`."""
    actuator: dict[str, Any] = Field(default={})
    """Values that replace values in `lab.actuator`."""


def on_plant(loaded: LoadedSpec, kind: PlantKind | None) -> LoadedSpec:
    """Return the spec with the plant that will be run: of a given kind, or the spec's own.

    Values of the lab's calibration file replace the spec's; the file's text is attached to the log.
    An unused `lab` section is kept for other runs.
    """
    experiment = loaded.experiment
    if kind == "sim" and not experiment.plant.simulated:
        updated = {"plant": KindSection(PLANTS, default="sim").make(), "lab": experiment.plant}
        return replace(loaded, experiment=experiment.model_copy(update=updated))
    if kind in (None, "sim") and experiment.plant.simulated:
        return loaded
    lab = lab_as(kind, lab_of(experiment, loaded.name))
    loaded = replace(loaded, experiment=experiment.model_copy(update={"plant": lab, "lab": None}))
    for loc, message in section_contradictions(loaded.experiment):
        raise SpecError(f"{loaded.name}: {dotted(loc)} {message}")
    if lab.calibration is None:
        return loaded
    path = (loaded.path.parent if loaded.path else Path()) / lab.calibration
    text = read_text(path)
    experiment = calibrated(loaded.experiment, text, str(path))
    attached = attach(loaded.attached, path, text)
    return replace(loaded, experiment=experiment, attached=attached)


def lab_as(kind: PlantKind | None, lab: LabSection) -> LabSection:
    """Return a lab as a plant of a kind; None and another package's kind change nothing."""
    if kind is None or kind == lab.type or VIRTUAL_LAB not in (kind, lab.type):
        return lab
    return PLANTS.load(kind).model_validate(dict(lab) | {"type": kind})


def lab_of(experiment: Experiment, name: str) -> LabSection:
    """Return the lab of an experiment; SpecError if it has none."""
    lab = experiment.lab if experiment.plant.simulated else experiment.plant
    if not isinstance(lab, LabSection):
        raise SpecError(
            f"{name}: has no lab",
            "add a 'lab:' section; `tetractl init --example three_m3pi_lab` has one",
        )
    return lab


def calibration_yaml(calibration: Calibration) -> str:
    """Return the text of a calibration file."""
    return dump(calibration.model_dump(mode="json"))


def calibrated(experiment: Experiment, text: str, origin: str) -> Experiment:
    """Return an experiment in the lab with the values of a calibration in its lab section.

    `text` is the calibration file, `origin` its name; its problems are reported as in a spec.
    """
    document = _calibration(text, origin)
    calibration = validated(Calibration, document)
    data = experiment.model_dump()
    places: dict[Loc, Place] = {}
    for device, values in (("camera", calibration.camera), ("actuator", calibration.actuator)):
        own, loc = data["plant"][device], ("plant", device)
        data["plant"][device] = _merged(own, values, loc, document, (device,), places)
    try:
        updated = Experiment.model_validate(frozen(data), strict=True, context=STRICT)
    except ValidationError as error:
        merged = Document(document.origin, data, values=places)
        raise InvalidSpecError(explain(error, merged)) from None
    for loc, message in section_contradictions(updated):
        raise SpecError(f"{origin}: with this calibration, {dotted(loc)} {message}")
    return updated


def _calibration(text: str, origin: str) -> Document:
    """Parse a calibration file; errors do not quote the text of a file of another kind."""
    try:
        document = parse_document(text, origin)
    except InvalidSpecError:
        document = None
    if document is None or "measured" not in document.data:
        raise SpecError(
            f"{printable(origin)}: is not a calibration file",
            "`tetractl lab calibrate` writes a calibration file",
        )
    return document


def _merged(
    base: Any, over: Any, loc: Loc, document: Document, at: Loc, places: dict[Loc, Place]
) -> Any:
    """Return `base`, the value at `loc` in the spec, updated by the values of `over`.

    `at` is the location of `over` in the calibration file. For each value, `places` gets its line
    and column in that file.
    """
    places[loc] = document.place(at)
    if isinstance(base, Mapping) and isinstance(over, Mapping):
        values = {
            key: _merged(base.get(key), value, (*loc, key), document, (*at, key), places)
            for key, value in over.items()
        }
        return {**base, **values}
    if _named(base) and _named(over):
        entries = list(base)
        for j, entry in enumerate(over):
            i = next((i for i, b in enumerate(base) if b["name"] == entry["name"]), None)
            if i is None:
                name = printable(str(entry["name"]), 60)
                raise SpecError(
                    f"{document.origin}: {name} is not a robot of the lab", "calibrate this lab"
                )
            entries[i] = _merged(entries[i], entry, (*loc, i), document, (*at, j), places)
        return entries
    return over


def _named(value: Any) -> bool:
    """Return whether a value is a list of mappings that each have a `name`."""
    if not isinstance(value, list | tuple):
        return False
    return all(isinstance(entry, Mapping) and "name" in entry for entry in value)
