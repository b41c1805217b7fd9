"""The default way in which `tetractl lab stop` stops the robots of an actuator."""

from collections.abc import Callable
from functools import partial

from tetractl.core.clock import Clock
from tetractl.core.errors import AbortError
from tetractl.core.setup import Setup
from tetractl.spec.lab_section import STOP_GAP_NS, STOPS, ActuatorSection


def stop_all(section: ActuatorSection, setup: Setup, clock: Clock, alone: bool) -> str:
    """Open the actuator and send ten emergency stops in 200 ms; see `ActuatorSection.stop_all`."""
    with section.build(setup, clock) as actuator:
        failure = send_stops(partial(actuator.stop, emergency=True), clock)
    if failure is not None:
        raise failure
    return f"sent {STOPS} stops"


def send_stops(
    stop: Callable[[], object], clock: Clock, are_ready: Callable[[], bool] = lambda: True
) -> AbortError | None:
    """Send STOPS stops to all robots, STOP_GAP_NS apart, even if one of the stops fails.

    A stop may fail for one robot while the others still need the following stops.

    Args:
        stop: Sends a stop to every robot.
        clock: The clock for the gaps.
        are_ready: Returns whether all robots receive stops. Until then, stops are sent to those
            that do.

    Returns:
        The first failure. None if there was none.
    """
    failure: AbortError | None = None
    remaining = STOPS
    while remaining > 0:
        remaining -= are_ready()
        try:
            stop()
        except AbortError as error:
            failure = failure or error
        clock.sleep_until(clock.now() + STOP_GAP_NS)
    return failure
