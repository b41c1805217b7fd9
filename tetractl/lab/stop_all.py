"""Stop all robots of an actuator, as `tetractl lab stop` does by default."""

from collections.abc import Callable
from functools import partial

from tetractl.core.clock import Clock
from tetractl.core.errors import AbortError
from tetractl.core.setup import Setup
from tetractl.spec.lab_section import STOP_COUNT, STOP_GAP_NS, ActuatorSection


def stop_all(section: ActuatorSection, setup: Setup, clock: Clock, alone: bool) -> str:
    """Open an actuator, and send ten emergency stops in 200 ms; see `ActuatorSection.stop_all`.

    Args:
        section: The actuator's section of the spec.
        setup: The constants of the experiment, with the robots' names.
        clock: The clock for the gaps between stops.
        alone: Ignored, because the actuator always opens its port in the same way.

    Returns:
        A sentence that tells the operator how many stops were sent.

    Raises:
        AbortError: If a stop could not be sent to all robots.
    """
    with section.build(setup, clock) as actuator:
        failure = send_stops(partial(actuator.stop, emergency=True), clock)
    if failure is not None:
        raise failure
    return f"sent {STOP_COUNT} stops"


def send_stops(
    stop: Callable[[], object], clock: Clock, are_ready: Callable[[], bool] = lambda: True
) -> AbortError | None:
    """Send STOPS stops to all robots, STOP_GAP_NS apart, even if one of the stops fails.

    A stop may fail for one robot while the others still need the following stops.

    Args:
        stop: Sends a stop to every robot.
        clock: The clock for the gaps.
        are_ready: Returns whether all robots can be reached. Stops that are sent before that do not
            count toward STOPS.

    Returns:
        The error of the first stop that failed. None if no stop failed.
    """
    failure: AbortError | None = None
    remaining = STOP_COUNT
    while remaining > 0:
        remaining -= are_ready()
        try:
            stop()
        except AbortError as error:
            failure = failure or error
        clock.sleep_until(clock.now() + STOP_GAP_NS)
    return failure
