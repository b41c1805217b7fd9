"""How `tetractl lab stop` stops the robots of an actuator that names no other way."""

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


def send_stops(stop: Callable[[], object], clock: Clock) -> AbortError | None:
    """Send STOPS stops, STOP_GAP_NS apart, even after one that fails.

    A stop may fail for one robot while the others still need the following stops.

    Returns:
        The first failure. None if there was none.
    """
    failure: AbortError | None = None
    for _ in range(STOPS):
        try:
            stop()
        except AbortError as error:
            failure = failure or error
        clock.sleep_until(clock.now() + STOP_GAP_NS)
    return failure
