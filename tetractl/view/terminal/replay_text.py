"""Prints a recorded trial without a terminal: one line for each control step."""

import math

from tetractl.core.clock import Clock, seconds
from tetractl.replay.clock import PlayerClock
from tetractl.replay.recording import Recording


def print_steps(
    recording: Recording,
    wall: Clock,
    span: tuple[int, int],
    *,
    rate: float | None = None,
    loop: bool = False,
) -> None:
    """Print the control steps of a span [ns], at `rate` times the trial's pace or all at once.

    A loop without a rate keeps the trial's own pace.
    """
    start_ns, until_ns = span
    pace = rate or (1.0 if loop else None)
    clock = PlayerClock(wall, at_ns=start_ns, rate=pace or 1.0)
    steps = [i for i, ns in enumerate(recording.step_ns) if start_ns <= ns <= until_ns]
    while True:
        for index in steps:
            if pace is not None:
                clock.sleep_until(int(recording.step_ns[index]))
            print(step_line(recording, index), flush=pace is not None)
        if not loop or not steps:
            return
        clock.sleep_until(until_ns)
        clock.jump(start_ns)


def step_line(recording: Recording, index: int) -> str:
    """Return one control step as a line of text."""
    step = recording.log.steps[index]
    unit = recording.log.start.setup.unit
    plan, u = step.plan, step.command.direction
    direction = "stop" if u is None else f"{math.degrees(math.remainder(u, math.tau)):+.1f} deg"
    time_s = seconds(int(recording.step_ns[index]))
    return (
        f"{time_s:6.2f} s  k {step.k:<3}  horizon {len(plan.signals):<3}  "
        f"J {plan.cost:7.1f} {unit}  total error {recording.totals[index]:7.1f} {unit}  "
        f"direction {direction:>10}  evaluations {plan.evaluations:<6}  "
        f"stopped {plan.search.stopped}"
    )
