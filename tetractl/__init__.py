"""tetractl: steer several robots at once with one control signal."""

from tetractl.core import __version__

TYPE_CHECKING = False  # type checkers read it as true; importing `typing` takes half the time
if TYPE_CHECKING:
    from tetractl.api.batches import run_batch, run_study
    from tetractl.api.checks import compare, summarise, verify
    from tetractl.api.drawings import play_page, plot, show
    from tetractl.api.logs import read_batch, read_log, to_arrays, to_dataframe
    from tetractl.api.simulated_trials import open_trial, run_trial
    from tetractl.api.specs import experiment_schema, load_spec, parse_spec
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

_MODULES = {
    "Actuator": "core.protocols",
    "Camera": "core.protocols",
    "Controller": "core.protocols",
    "Experiment": "spec.experiment",
    "Observation": "core.poses",
    "Observer": "core.protocols",
    "Optimizer": "core.protocols",
    "Outcome": "core.plan",
    "Plan": "core.plan",
    "Poses": "core.poses",
    "TetractlError": "core.errors",
    "TrialLog": "log.read.trial_log",
    "compare": "api.checks",
    "experiment_schema": "api.specs",
    "load_spec": "api.specs",
    "open_trial": "api.simulated_trials",
    "parse_spec": "api.specs",
    "play_page": "api.drawings",
    "plot": "api.drawings",
    "read_batch": "api.logs",
    "read_log": "api.logs",
    "run_batch": "api.batches",
    "run_study": "api.batches",
    "run_trial": "api.simulated_trials",
    "show": "api.drawings",
    "summarise": "api.checks",
    "to_arrays": "api.logs",
    "to_dataframe": "api.logs",
    "verify": "api.checks",
}

if not TYPE_CHECKING:  # a type checker that sees `__getattr__` accepts every name

    def __getattr__(name):
        """Import a public name when it is first used, so that `import tetractl` is quick."""
        if name not in _MODULES:
            raise AttributeError(f"module 'tetractl' has no attribute '{name}'")
        from pkgutil import resolve_name

        return resolve_name(f"tetractl.{_MODULES[name]}:{name}")


def __dir__() -> list[str]:
    return sorted(__all__)


del TYPE_CHECKING
