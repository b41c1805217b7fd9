"""Select the plant on which a spec will run, and apply a calibration file to its lab.

`Prepare` is the type of the functions that find the robots of a trial on its plant. See
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
from tetractl.spec.base import Model, validate_document
from tetractl.spec.consistency import find_section_errors
from tetractl.spec.experiment import Experiment
from tetractl.spec.lab_section import LabSection
from tetractl.spec.loaded_spec import LoadedSpec, attach_file
from tetractl.spec.packages import explain_missing
from tetractl.spec.plant import PlantSection
from tetractl.spec.yaml.document import Document, parse_document
from tetractl.spec.yaml.problems import InvalidSpecError, Loc, format_loc
from tetractl.spec.yaml.settings import create_path
from tetractl.spec.yaml.spec_files import read_text, resolve_path


@dataclass(frozen=True, slots=True)
class PreparedTrial:
    """The experiment of a trial, with the robots that were found, and the plant of the trial."""

    experiment: Experiment
    plant: Plant


Prepare = Callable[[Experiment, Clock, np.random.SeedSequence, LabSupervision], PreparedTrial]
"""The type of a function that finds the robots of a trial.

Its arguments are the experiment, the clock and the seed of the trial, and the `LabSupervision`,
which only real robots need. It raises UsageError if robots cannot be found on the experiment's
plant, and AbortError if they were not found.
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


def select_plant(loaded: LoadedSpec, kind: str | None, with_calibration: bool = True) -> LoadedSpec:
    """Return a spec with the plant on which it will run, such as its simulation or its lab.

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
    if kind is not None and not is_lab_kind(kind):
        lab = experiment.lab if experiment.plant.simulated else experiment.plant
        updated = {"plant": _create_default_plant(kind), "lab": lab}
        return replace(loaded, experiment=experiment.model_copy(update=updated))
    folder = loaded.path.parent if loaded.path else None
    lab = convert_lab(kind, get_lab(experiment, loaded.name)).with_files(folder)
    in_lab = experiment.model_copy(update={"plant": lab, "lab": None})
    loaded = replace(loaded, experiment=in_lab)
    for error in find_section_errors(loaded.experiment):
        raise SpecError(f"{loaded.name}: {format_loc(error.loc)} {error}")
    if lab.calibration is None or not with_calibration:
        return loaded
    path = resolve_path(folder, "lab.calibration", lab.calibration)
    text = read_text(path)
    experiment = apply_calibration(loaded.experiment, text, str(path))
    attached = attach_file(loaded.attached, path, text)
    return replace(loaded, experiment=experiment, attached=attached)


def _create_default_plant(kind: str) -> PlantSection:
    try:
        return PLANTS.load(kind).model_validate({"type": kind})
    except ValidationError as error:
        locations = [details["loc"] for details in error.errors()]
        fields = ", ".join(str(loc[0]) for loc in locations if loc)
        raise UsageError(
            f"--plant {kind}: write this plant into the spec instead, because "
            f"it needs the fields {fields}"
        ) from None


def adapt_settings(spec: Document, sets: Sequence[str], kind: str | None) -> list[str]:
    """Adapt the values of `--set` to the plant on which a spec will run.

    If the plant is the spec's `lab`, settings of `plant` become settings of `lab`.

    Args:
        spec: The spec.
        sets: The settings, such as "plant.limits.stale=0.2".
        kind: The kind of plant. None for the spec's own plant.
    """
    names_plant = any(setting.startswith("plant.") for setting in sets)
    if kind is None or not names_plant or not is_lab_kind(kind):
        return list(sets)
    if "lab" not in spec.data:
        return list(sets)
    lab_settings = [re.sub(r"^plant\.", "lab.", setting) for setting in sets]
    return [f"lab.type={kind}", *lab_settings]


def is_lab_kind(kind: str) -> bool:
    """Check whether a kind of plant is a lab, real or emulated, with a lab's fields.

    Raises:
        UsageError: If there is no such kind of plant.
    """
    if kind not in PLANTS:
        problem, hint = explain_missing(PLANTS.group, kind) or ("there is no such plant", None)
        raise UsageError(
            f"--plant {kind}: {problem}",
            hint or f"the known plants are {', '.join(PLANTS.names())}",
        )
    section: type[PlantSection] = PLANTS.load(kind)
    return issubclass(section, LabSection)


def convert_lab(kind: str | None, lab: LabSection) -> LabSection:
    """Convert the lab of a spec to a plant of another kind, such as an emulated lab.

    The lab is unchanged if `kind` is None, or if it is "lab" and the lab is real.
    """
    if kind is None or kind == lab.type or (kind == "lab" and lab.real_time):
        return lab
    section: type[LabSection] = PLANTS.load(kind)
    shared = {name: value for name, value in lab if name in section.model_fields}
    return section.model_validate(shared | {"type": kind})


def get_lab(experiment: Experiment, name: str) -> LabSection:
    """Return the lab of an experiment: its plant or, if the plant is simulated, the section `lab`.

    Args:
        experiment: The experiment.
        name: Name of the spec, with which an error message starts.

    Raises:
        SpecError: If the experiment has no lab.
    """
    lab = experiment.lab if experiment.plant.simulated else experiment.plant
    if not isinstance(lab, LabSection):
        raise SpecError(
            f"{name}: this spec has no lab",
            "add a section 'lab:'; `tetractl init --example three_m3pi_lab` writes a spec "
            "with a lab",
        )
    return lab


def apply_calibration(experiment: Experiment, text: str, origin: str) -> Experiment:
    """Apply the measured values of a calibration to the lab of an experiment.

    Args:
        experiment: The experiment.
        text: The contents of the calibration file.
        origin: The name of the calibration file, for error messages.
    """
    document = _parse_calibration(text, origin)
    validate_document(Calibration, document)
    document.require_no_problems()
    calibrated = Document(document.origin, experiment.model_dump(mode="json"))
    for name, field in type(experiment.plant).model_fields.items():
        if field.exclude:  # the dump leaves it out, since no log is to have it
            calibrated.data["plant"][name] = getattr(experiment.plant, name)
    for device in ("camera", "actuator"):
        section = document.data.get(device, {})
        for path, measured_loc, value in _find_single_values(section, (device,), (device,)):
            place = document.place(measured_loc)
            loc = create_path(calibrated, ("plant", *path), place)
            if value != {} or loc[-1] not in calibrated.holder(loc):
                calibrated.put(loc, value, place)
    experiment_in_lab = validate_document(Experiment, calibrated)
    for error in find_section_errors(experiment_in_lab):
        raise SpecError(
            f"{origin}: if this calibration is applied, the field {format_loc(error.loc)} {error}"
        )
    return experiment_in_lab


def _parse_calibration(text: str, origin: str) -> Document:
    """Parse the text of a calibration file.

    Raises:
        SpecError: If the text is not YAML, or lacks the key `measured`. The message does not quote
            the text, because it may be another kind of file.
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


def _find_single_values(
    value: Any, path: tuple[str, ...], loc_in_file: Loc
) -> Iterator[tuple[tuple[str, ...], Loc, Any]]:
    """Yield every single value in a section of a calibration file, at any depth.

    The section consists of mappings, and of lists whose entries have names. Any other value, and an
    empty mapping or list, counts as a single value.

    Yields:
        The value's path by the names of entries, its location in the file, and the value.
    """
    inner_values: list[tuple[str, str | int, Any]] = []
    if isinstance(value, dict):
        inner_values = [(key, key, inner_value) for key, inner_value in value.items()]
    elif isinstance(value, list) and all(
        isinstance(list_entry, dict) and "name" in list_entry for list_entry in value
    ):
        inner_values = [(str(entry["name"]), i, entry) for i, entry in enumerate(value)]
    if not inner_values:
        yield path, loc_in_file, value
    for name, key, inner_value in inner_values:
        yield from _find_single_values(inner_value, (*path, name), (*loc_in_file, key))
