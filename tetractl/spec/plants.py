"""Select the plant of an experiment, and apply a calibration file to its lab.

`Prepare` is the type of a function that finds the robots of a trial on its plant. See
`TrialRobots`.
"""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydantic import Field, ValidationError

from tetractl.core.clock import Clock
from tetractl.core.errors import SpecError, UsageError, printable
from tetractl.core.protocols import LabSupervision, Plant
from tetractl.core.registries import PLANTS
from tetractl.spec.base import Model, validated
from tetractl.spec.consistency import find_section_errors
from tetractl.spec.experiment import Experiment
from tetractl.spec.lab_section import LabSection
from tetractl.spec.loaded_spec import LoadedSpec, attach
from tetractl.spec.packages import not_installed
from tetractl.spec.plant import PlantSection
from tetractl.spec.yaml.document import Document, parse_document
from tetractl.spec.yaml.problems import InvalidSpecError, Loc, dotted
from tetractl.spec.yaml.settings import make_way
from tetractl.spec.yaml.spec_files import file_of_spec, read_text


@dataclass(frozen=True, slots=True)
class PreparedTrial:
    """The experiment of a trial with the robots that were found, and its plant."""

    experiment: Experiment
    plant: Plant


Prepare = Callable[[Experiment, Clock, np.random.SeedSequence, LabSupervision], PreparedTrial]
"""A function that finds the robots of a trial.

It takes the experiment, the clock and the seed of the trial, and how people supervise it, which
only real robots need. It raises UsageError if robots cannot be found on the experiment's plant, and
AbortError if they were not found.
"""


class Calibration(Model):
    """The result of `tetractl lab calibrate`: values for the lab's sections."""

    measured: str = Field(max_length=100)
    """Date and time of the measurement."""
    emulated: str | None = Field(default=None, max_length=100)
    """The devices that were not real, such as `camera, actuator`. None in a real lab."""
    camera: dict[str, Any] = Field(default={})
    """Values that replace values in `lab.camera`."""
    actuator: dict[str, Any] = Field(default={})
    """Values that replace values in `lab.actuator`."""


def on_plant(loaded: LoadedSpec, kind: str | None, with_calibration: bool = True) -> LoadedSpec:
    """Return the spec with the plant that will be run.

    A `lab` section that is not used is kept for other runs.

    Args:
        loaded: The spec.
        kind: The kind of plant. None for the spec's own plant.
        with_calibration: Whether values of the lab's calibration file replace the spec's. The
            file's text is then attached to the log.

    Raises:
        SpecError: If the calibration file is relative to a spec that comes from no file.
    """
    experiment = loaded.experiment
    if experiment.plant.simulated and kind in (None, "sim", experiment.plant.type):
        return loaded
    if kind is not None and not of_lab(kind):
        lab = experiment.lab if experiment.plant.simulated else experiment.plant
        updated = {"plant": _with_defaults(kind), "lab": lab}
        return replace(loaded, experiment=experiment.model_copy(update=updated))
    folder = loaded.path.parent if loaded.path else None
    lab = lab_as(kind, lab_of(experiment, loaded.name)).with_files(folder)
    in_lab = experiment.model_copy(update={"plant": lab, "lab": None})
    loaded = replace(loaded, experiment=in_lab)
    for error in find_section_errors(loaded.experiment):
        raise SpecError(f"{loaded.name}: {dotted(error.where)} {error}")
    if lab.calibration is None or not with_calibration:
        return loaded
    path = file_of_spec(folder, "lab.calibration", lab.calibration)
    text = read_text(path)
    experiment = calibrated(loaded.experiment, text, str(path))
    attached = attach(loaded.attached, path, text)
    return replace(loaded, experiment=experiment, attached=attached)


def _with_defaults(kind: str) -> PlantSection:
    try:
        return PLANTS.load(kind).model_validate({"type": kind})
    except ValidationError as error:
        locations = [details["loc"] for details in error.errors()]
        fields = ", ".join(str(loc[0]) for loc in locations if loc)
        raise UsageError(
            f"--plant {kind}: write this plant into the spec instead, because "
            f"it needs the fields {fields}"
        ) from None


def settings_on(spec: Document, sets: Sequence[str], kind: str | None) -> list[str]:
    """Adapt settings to the plant on which the spec will run.

    If that is the spec's `lab`, settings of `plant` become settings of `lab`.

    Args:
        spec: The spec.
        sets: The settings, such as "plant.limits.stale=0.2".
        kind: The kind of plant. None for the spec's own plant.
    """
    named = any(setting.startswith("plant.") for setting in sets)
    if kind is None or not named or not of_lab(kind):
        return list(sets)
    if "lab" not in spec.data:
        return list(sets)
    moved = [re.sub(r"^plant\.", "lab.", setting) for setting in sets]
    return [f"lab.type={kind}", *moved]


def of_lab(kind: str) -> bool:
    """Check whether a kind of plant has the fields of a lab.

    Raises:
        UsageError: If there is no such kind.
    """
    if kind not in PLANTS:
        why, hint = not_installed(PLANTS.group, kind) or ("there is no such plant", None)
        raise UsageError(
            f"--plant {kind}: {why}", hint or f"the known plants are {', '.join(PLANTS.names())}"
        )
    section: type[PlantSection] = PLANTS.load(kind)
    return issubclass(section, LabSection)


def lab_as(kind: str | None, lab: LabSection) -> LabSection:
    """Convert the lab of a spec to a plant of another kind, such as an emulated lab.

    The lab is unchanged if `kind` is None, or if it is "lab" and the lab is real.
    """
    if kind is None or kind == lab.type or (kind == "lab" and lab.real_time):
        return lab
    section: type[LabSection] = PLANTS.load(kind)
    shared = {name: value for name, value in lab if name in section.model_fields}
    return section.model_validate(shared | {"type": kind})


def lab_of(experiment: Experiment, name: str) -> LabSection:
    """Return the lab of an experiment: its plant or, if that is simulated, the section `lab`.

    Raises:
        SpecError: If it has no lab. The message starts with `name`.
    """
    lab = experiment.lab if experiment.plant.simulated else experiment.plant
    if not isinstance(lab, LabSection):
        raise SpecError(
            f"{name}: this spec has no lab",
            "add a section 'lab:'; `tetractl init --example three_m3pi_lab` writes a spec "
            "with a lab",
        )
    return lab


def calibrated(experiment: Experiment, text: str, origin: str) -> Experiment:
    """Apply the measured values of a calibration to the lab of an experiment.

    Args:
        experiment: The experiment.
        text: The contents of the calibration file.
        origin: The name of the file. Its problems are reported like those of a spec.
    """
    document = _calibration(text, origin)
    validated(Calibration, document)
    document.require_no_problems()
    merged = Document(document.origin, experiment.model_dump(mode="json"))
    for name, field in type(experiment.plant).model_fields.items():
        if field.exclude:  # the dump leaves it out, since no log is to have it
            merged.data["plant"][name] = getattr(experiment.plant, name)
    for device in ("camera", "actuator"):
        section = document.data.get(device, {})
        for path, measured_loc, value in _single_values(section, (device,), (device,)):
            place = document.place(measured_loc)
            loc = make_way(merged, ("plant", *path), place)
            if value != {} or loc[-1] not in merged.holder(loc):
                merged.put(loc, value, place)
    updated = validated(Experiment, merged)
    for error in find_section_errors(updated):
        raise SpecError(
            f"{origin}: if this calibration is applied, the field {dotted(error.where)} {error}"
        )
    return updated


def _calibration(text: str, origin: str) -> Document:
    """Parse a calibration file. Errors do not quote the text of other kinds of files.

    Raises:
        SpecError: If it is not YAML, or lacks the key `measured`.
    """
    try:
        document = parse_document(text, origin)
    except InvalidSpecError:
        document = None
    if document is None or "measured" not in document.data:
        raise SpecError(
            f"{printable(origin)}: this is not a calibration file",
            "`tetractl lab calibrate` writes a calibration file",
        )
    return document


def _single_values(
    value: Any, path: tuple[str, ...], loc: Loc
) -> Iterator[tuple[tuple[str, ...], Loc, Any]]:
    """Yield every single value in a mapping, or in a list of named entries, in the lab section.

    Each value comes with its path by the names of entries, and its location in the file. A value
    that is neither a mapping nor such a list, or is empty, is itself yielded.
    """
    inside: list[tuple[str, str | int, Any]] = []
    if isinstance(value, dict):
        inside = [(key, key, item) for key, item in value.items()]
    elif isinstance(value, list) and all(isinstance(e, dict) and "name" in e for e in value):
        inside = [(str(entry["name"]), i, entry) for i, entry in enumerate(value)]
    if not inside:
        yield path, loc, value
    for name, key, item in inside:
        yield from _single_values(item, (*path, name), (*loc, key))
