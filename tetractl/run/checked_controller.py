"""A wrapper of a controller that checks each decision once, before it is sent and logged."""

import copy
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from operator import index
from typing import Any, get_type_hints

import numpy as np

from tetractl.control.search.work_clock import WorkClock
from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, FieldOff, Stop, Turn
from tetractl.core.errors import WrongValueError, describe_error
from tetractl.core.loggable import check_actions, check_plan, stop_reason
from tetractl.core.motion_estimate import Estimate, PredictionErrors
from tetractl.core.plan import Decision, End, Outcome, Plan, Search, State, StopReason
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Setup
from tetractl.spec.controller import ALONE, ControllerSection, Host
from tetractl.spec.experiment import Experiment

PLAN_SIZE_MAX = 1 << 19
"""Maximum number of floats in a plan.

It is a quarter of the size of the largest chunk of a log that is read (`CHUNK_MAX` of
`tetractl.log.read.limits`).
"""


def build_controller(experiment: Experiment, key: int) -> "CheckedController":
    """Create the controller of one trial.

    In virtual time, the controller's timer counts the work of its searches instead of seconds.

    Args:
        experiment: The experiment.
        key: Seed of the controller's random numbers.
    """
    work_clock = WorkClock()
    host = ALONE if experiment.plant.real_time else Host(work_clock.wrap, work_clock)
    return CheckedController(experiment.controller, experiment.setup, key, host)


class CheckedController:
    """A wrapper of a controller that checks each of its decisions before they are used.

    A controller from another package gets its own setup, and its plans are copied. If it later
    writes into arrays, neither the commands nor the log change.

    Args:
        section: The section of the controller.
        setup: The constants of the experiment.
        key: Seed of the controller's random numbers.
        host: Provides the controller's timer, and wraps its optimiser.
    """

    def __init__(
        self, section: ControllerSection, setup: Setup, key: int, host: Host = ALONE
    ) -> None:
        self._section = section
        self._setup = setup
        self._leg_count = len(setup.legs)
        self._is_built_in = type(section).__module__.startswith("tetractl.")
        self.controller = section.build(
            setup if self._is_built_in else copy.deepcopy(setup), key, host
        )

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Decision:
        """Let the controller decide, and check the decision; see `Controller.plan`.

        Raises:
            WrongValueError: If the decision cannot be sent or logged.
        """
        decision: Any = self.controller.plan(observation, last_command, earlier)
        try:
            return self._check_decision(decision)
        except ValueError as error:
            message = f"a {type(decision).__name__} that is not valid: {error}"
            controller_name = f"controller '{self._section.type}'"
            raise WrongValueError(controller_name, message) from None

    def _check_decision(self, decision: Any) -> Decision:
        """Check that a decision can be sent and logged. Raises ValueError if it cannot."""
        if isinstance(decision, Outcome):
            return _check_outcome(decision)
        if not isinstance(decision, Plan | End):
            raise ValueError("the method `plan` must return a Plan, an Outcome or an End")
        checked: Plan | End = decision
        if not self._is_built_in:
            checked = _convert_record(Plan if isinstance(decision, Plan) else End, decision)
        if isinstance(checked, Plan):
            check_plan(checked, len(self._setup.names))
            for search in checked.searches:
                if not 0 <= search.evaluations < 1 << 63:
                    raise ValueError(
                        f"a search has {search.evaluations} evaluations, but the number must be "
                        "from 0 to 2^63 - 1"
                    )
            search_number_count = sum(
                search.signals.size + search.history.size for search in checked.searches
            )
            if checked.signals.size + checked.path.size + search_number_count > PLAN_SIZE_MAX:
                raise ValueError(
                    "its signals, path and searches together have more than "
                    f"{PLAN_SIZE_MAX} numbers, which is too many to log"
                )
            if not 0 <= checked.chosen < len(checked.searches):
                raise ValueError(
                    f"its field `chosen` is {checked.chosen}, but it must be from 0 to "
                    f"{len(checked.searches) - 1}, the index of one of its searches"
                )
            if not (0 <= checked.leg <= self._leg_count and 0 <= checked.generator < 1 << 64):
                raise ValueError(
                    f"its field `leg` is {checked.leg}, and must be from 0 to {self._leg_count}; "
                    f"its field `generator` is {checked.generator}, and must be from 0 to 2^64 - 1"
                )
        if not 0 <= checked.delay_ns <= round(self._setup.period_s * SECOND):
            raise ValueError(
                f"its field `delay_ns` is {checked.delay_ns}, but it must be from 0 to one control "
                f"period, {round(self._setup.period_s * SECOND)} ns"
            )
        return checked


class _FieldError(ValueError):
    pass


def _convert_record(record_class: type[Any], source: object) -> Any:
    """Copy the fields of an object into a new record of class `record_class`.

    Raises ValueError if a field is missing or has a wrong type.
    """
    values: dict[str, Any] = {}
    for name, hint in _type_hints(record_class).items():
        try:
            values[name] = _CONVERTERS[hint](getattr(source, name))
        except _FieldError:
            raise
        except Exception as error:  # objects of any class may raise anything
            raise _FieldError(f"{name}: {describe_error(error)}") from None
    return record_class(**values)


_type_hints = cache(get_type_hints)


def _to_array(value: Any) -> Floats:
    array = np.asarray(value)
    if array.size > PLAN_SIZE_MAX:
        raise ValueError(f"{array.size} numbers")
    return array.astype(np.float64, casting="same_kind")  # not of text, objects, complex numbers


def _check_outcome(value: Any) -> Outcome:
    if not (isinstance(value, Outcome) and value.complete):
        raise ValueError(f"a controller cannot end a trial with the outcome {value}")
    return value


def _to_action(value: Any) -> Turn | Stop | FieldOff | None:
    if not isinstance(value, Turn | Stop | FieldOff | None):
        type_name = type(value).__name__
        raise TypeError(f"an action must be Turn, Stop, FieldOff or None, not {type_name}")
    if value is not None:
        check_actions([value])
    return value


def _to_numbers(value: Any) -> dict[str, float]:
    return {str(name): float(number) for name, number in value.items()}


def _optional(convert: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda value: None if value is None else convert(value)


_CONVERTERS: Mapping[Any, Callable[[Any], Any]] = {
    Floats: _to_array, float: float, int: index, State: State, Outcome: _check_outcome,
    Floats | None: _optional(_to_array), float | None: _optional(float),
    StopReason | str: stop_reason,
    tuple[Search, ...]: lambda searches: tuple(_convert_record(Search, item) for item in searches),
    Estimate | None: _optional(lambda estimate: _convert_record(Estimate, estimate)),
    PredictionErrors | None: _optional(lambda errors: _convert_record(PredictionErrors, errors)),
    Turn | Stop | FieldOff | None: _to_action, Mapping[str, float]: _to_numbers,
}  # fmt: skip
