"""Waits until a run may start: everything well, and every robot at rest on its start."""

from tetractl.core.clock import SECOND
from tetractl.core.errors import AbortError
from tetractl.core.supervision import LabSupervision
from tetractl.lab.preflight import Preflight, inspect, unplaced
from tetractl.lab.rest_check import moving_robots
from tetractl.lab.rig import Rig

LOOK_NS = SECOND // 5  # how often places are checked
GRACE_S = 1.0  # waited at least, for frames that are missing now and then
SILENCE_S = 0.5  # a camera silent for this long ends the wait, or longer if the spec bears it


def wait_until_ready(rig: Rig, supervision: LabSupervision) -> Preflight:
    """Return once all is well, every robot is on its start and a person, if there is one, agrees.

    Robots that can stand still must do so. Robots that are carried may be off and out
    of sight for a while: without a person, `limits.placing` is how long. AbortError says what is
    wrong and who is how far off; KeyboardInterrupt where a person wants to wait no longer.
    """
    prompt, clock = supervision.prompt, rig.clock
    limit_ns = round(max(rig.limits.placing, GRACE_S) * SECOND)
    began = clock.now()
    while True:
        findings: Preflight | None = None
        lines = unplaced(rig) or (moving_robots(rig) if rig.actuator.halts else [])
        if lines:  # why a robot is not tracked comes before that it is not
            lines = [*rig.camera.check().problems, *lines]
        if not lines:
            findings = inspect(rig)
            lines = list(dict.fromkeys((*findings.all_problems, *unplaced(rig))))
        if prompt is not None:
            prompt.place(lines, findings.questions if findings else ())
        if findings is not None and not lines and (prompt is None or prompt.go()):
            return findings
        if supervision.emergency.is_set():
            raise AbortError("emergency stop by the operator")
        if supervision.cancelled():
            raise KeyboardInterrupt
        _check_stream(rig)
        if prompt is None and clock.now() - began >= limit_ns:
            problems = (findings or inspect(rig)).all_problems
            raise AbortError(
                "; ".join(dict.fromkeys((*problems, *lines))),
                "see `tetractl lab check`; limits.placing waits for robots to be placed",
            )
        clock.sleep_until(clock.now() + LOOK_NS)


def _check_stream(rig: Rig) -> None:
    silent_ns = rig.silent_ns()
    if silent_ns > max(rig.limits.stream_lost, SILENCE_S) * SECOND:
        raise AbortError(rig.guard.no_frame(silent_ns))
