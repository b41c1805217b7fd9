"""tetractl: steer several robots at once with one control signal."""

from tetractl.core import __version__

TYPE_CHECKING = False  # type checkers read it as true; importing `typing` takes half the time
if TYPE_CHECKING:
    from tetractl.api import (
        compare,
        experiment_schema,
        load_spec,
        open_trial,
        parse_spec,
        play_page,
        plot,
        read_batch,
        read_log,
        run_batch,
        run_study,
        run_trial,
        show,
        summarise,
        to_arrays,
        to_dataframe,
        verify,
    )
    from tetractl.core.errors import TetractlError
    from tetractl.core.plan import Outcome, Plan
    from tetractl.core.poses import Observation, Poses
    from tetractl.core.protocols import Actuator, Camera, Controller, Observer, Optimizer
    from tetractl.log.read.trial_log import TrialLog
    from tetractl.spec.experiment import Experiment

__all__ = [
    "Actuator",
    "Camera",
    "Controller",
    "Experiment",
    "Observation",
    "Observer",
    "Optimizer",
    "Outcome",
    "Plan",
    "Poses",
    "TetractlError",
    "TrialLog",
    "__version__",
    "compare",
    "experiment_schema",
    "load_spec",
    "open_trial",
    "parse_spec",
    "play_page",
    "plot",
    "read_batch",
    "read_log",
    "run_batch",
    "run_study",
    "run_trial",
    "show",
    "summarise",
    "to_arrays",
    "to_dataframe",
    "verify",
]

_TYPES = {
    "Actuator": "tetractl.core.protocols:Actuator",
    "Camera": "tetractl.core.protocols:Camera",
    "Controller": "tetractl.core.protocols:Controller",
    "Experiment": "tetractl.spec.experiment:Experiment",
    "Observation": "tetractl.core.poses:Observation",
    "Observer": "tetractl.core.protocols:Observer",
    "Optimizer": "tetractl.core.protocols:Optimizer",
    "Outcome": "tetractl.core.plan:Outcome",
    "Plan": "tetractl.core.plan:Plan",
    "Poses": "tetractl.core.poses:Poses",
    "TetractlError": "tetractl.core.errors:TetractlError",
    "TrialLog": "tetractl.log.read.trial_log:TrialLog",
}

if not TYPE_CHECKING:  # a type checker that sees `__getattr__` accepts every name

    def __getattr__(name):
        """Import a public name when it is first used, so that `import tetractl` is quick."""
        if name not in __all__:
            raise AttributeError(f"module 'tetractl' has no attribute '{name}'")
        from pkgutil import resolve_name

        return resolve_name(_TYPES.get(name, f"tetractl.api:{name}"))


def __dir__() -> list[str]:
    return sorted(__all__)


del TYPE_CHECKING
