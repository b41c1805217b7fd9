"""How `tetractl lab stop` stops the robots of an actuator that names no other way."""

from collections.abc import Callable
from functools import partial

from tetractl.core.clock import Clock
from tetractl.core.errors import AbortError
from tetractl.core.setup import Setup
from tetractl.spec.lab_section import STOP_GAP_NS, STOPS, ActuatorSection


def stop_all(section: ActuatorSection, setup: Setup, clock: Clock, alone: bool) -> str:
    """Open the actuator and send it ten emergency stops within 200 ms; return a summary, as
    `ActuatorSection.stop_all`."""
    with section.build(setup, clock) as actuator:
        failure = send_stops(partial(actuator.stop, emergency=True), clock)
    if failure is not None:
        raise failure
    return f"sent {STOPS} stops"


def send_stops(stop: Callable[[], object], clock: Clock) -> AbortError | None:
    """Send STOPS stops, STOP_GAP_NS apart, also after one that fails: it may fail for one robot,
    and the others need those to come. Return the first failure, None without one."""
    failure: AbortError | None = None
    for _ in range(STOPS):
        try:
            stop()
        except AbortError as error:
            failure = failure or error
        clock.sleep_until(clock.now() + STOP_GAP_NS)
    return failure
