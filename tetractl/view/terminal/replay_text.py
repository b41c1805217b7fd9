"""Prints a recorded trial without a terminal: one line for each control step and each event."""

import math

from tetractl.core.clock import Clock
from tetractl.log.read.trial_log import Event
from tetractl.replay.player import PlayerClock, Recording


def print_lines(
    recording: Recording,
    wall: Clock,
    span: tuple[int, int],
    *,
    rate: float | None = None,
    loop: bool = False,
) -> None:
    """Print the control steps and events of a span [ns], in the order of their times.

    They come at `rate` times the trial's pace or all at once. A loop without a rate keeps the
    trial's own pace.
    """
    start_ns, until_ns = span
    pace = rate or (1.0 if loop else None)
    clock = PlayerClock(wall, at_ns=start_ns, rate=pace or 1.0)
    lines = _lines(recording, start_ns, until_ns)
    while True:
        for time_ns, line in lines:
            if pace is not None:
                clock.sleep_until(time_ns)
            print(line, flush=pace is not None)
        if not loop or not lines:
            return
        clock.sleep_until(until_ns)
        clock.jump(start_ns)


def _lines(recording: Recording, start_ns: int, until_ns: int) -> list[tuple[int, str]]:
    """Return times [ns] and lines; a step comes before the events of its time."""
    steps = [(int(ns), step_line(recording, i)) for i, ns in enumerate(recording.step_ns)]
    lines = map(event_line, recording.events)
    events = list(zip(map(int, recording.event_ns), lines, strict=True))
    found = sorted([*steps, *events], key=lambda item: item[0])
    return [(ns, line) for ns, line in found if start_ns <= ns <= until_ns]


def event_line(event: Event) -> str:
    """Return one event as a line of text."""
    return f"{event.time_s:6.2f} s  {event.level}: {event.text}"


def step_line(recording: Recording, index: int) -> str:
    """Return one control step as a line of text."""
    step = recording.log.steps[index]
    unit = recording.log.start.setup.unit
    plan, u = step.plan, step.command.direction
    direction = (
        "field off" if u is None else f"{math.degrees(math.remainder(u, math.tau)):+.1f} deg"
    )
    time_s = recording.elapsed_s(int(recording.step_ns[index]))
    return (
        f"{time_s:6.2f} s  k {step.k:<3}  horizon {len(plan.signals):<3}  "
        f"J {plan.cost:7.1f} {unit}  total error {recording.totals[index]:7.1f} {unit}  "
        f"direction {direction:>10}  evaluations {plan.evaluations:<6}  "
        f"stopped {plan.search.stopped}"
    )
