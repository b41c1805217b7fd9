"""Every seam of a spec by name. A new kind is one file and one line here, or an entry point."""

from collections.abc import Iterator
from typing import Any

from tetractl.core.registry import Registry
from tetractl.experiment.base import Model

SECTION = "tetractl.experiment.base:Model"

OPTIMIZERS = Registry(
    "tetractl.optimizers",
    "optimizer",
    {
        "pso": "tetractl.experiment.controller:SwarmSpec",
        "multistart": "tetractl.experiment.controller:MultistartSpec",
    },
    SECTION,
)
CONTROLLERS = Registry(
    "tetractl.controllers",
    "controller",
    {"pso-mpc": "tetractl.experiment.controller:PsoMpcSpec"},
    SECTION,
)
MOTIONS = Registry(
    "tetractl.motions",
    "motion",
    {
        "euler": "tetractl.model.cell:euler",
        "arc": "tetractl.model.cell:arc",
        "exact": "tetractl.model.cell:exact",
    },
)
SHAPES = Registry(
    "tetractl.shapes",
    "shape",
    {
        "rectangle": "tetractl.experiment.experiment:Rectangle",
        "circle": "tetractl.experiment.experiment:Circle",
    },
    SECTION,
)
CAMERAS = Registry(
    "tetractl.cameras",
    "camera",
    {},
    SECTION,
)
ACTUATORS = Registry(
    "tetractl.actuators",
    "actuator",
    {},
    SECTION,
)
SEAMS = (OPTIMIZERS, CONTROLLERS, MOTIONS, SHAPES, CAMERAS, ACTUATORS)


def packages(spec: Model) -> dict[str, str]:
    """Return name and version of every other package that provides a kind used in a spec."""
    found: dict[str, str] = {}
    for section in _sections(spec):
        name = getattr(section, "type", None)
        for seam in SEAMS:  # two of them may have a kind of the same name
            if name in seam and seam.kind(name).package and type(section) is seam.load(name):
                found[seam.kind(name).package] = seam.kind(name).version
    return found


def _sections(value: Any) -> Iterator[Model]:
    """Yield a section and all sections in it."""
    if isinstance(value, Model):
        yield value
        value = tuple(dict(value).values())
    if isinstance(value, tuple):
        for item in value:
            yield from _sections(item)
