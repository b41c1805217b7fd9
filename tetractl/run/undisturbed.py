"""The experiment of a spec without its disturbances: robots do exactly what the model says."""

from tetractl.core.errors import UsageError
from tetractl.spec.load import parse_spec
from tetractl.spec.loaded_spec import LoadedSpec
from tetractl.spec.yaml.core_yaml import format_yaml

MODEL_MOTION = "exact"
"""The kind of motion of the simulation if the spec's plant does not state one."""


def undisturbed_spec(spec: LoadedSpec) -> LoadedSpec:
    """Return a spec whose simulated robots do exactly what its model says.

    The plant becomes a simulation without disturbances, noise, wheels or delays, and the controller
    is configured for that: its dead time and the lag of wheels are 0. Robots, targets, obstacles,
    arena, controller and seed stay.

    Raises:
        UsageError: If a camera finds the robots of each trial, as in a survey of a dish.
    """
    experiment = spec.experiment
    if experiment.chosen is not None:
        raise UsageError(
            "a trial of this spec chooses its robots itself, so they are unknown before the trial"
        )
    fields = experiment.model_dump(mode="json")
    motion = fields["plant"].get("motion", MODEL_MOTION)
    fields["plant"] = {"type": "sim", "motion": motion}
    fields["controller"]["dead_time"] = 0.0
    if fields.get("wheels"):
        fields["wheels"]["lag"] = 0.0
    return parse_spec(format_yaml(fields), spec.name)
