"""Checks of a camera and of an actuator; no robot moves."""

from typing import Any

from tetractl.core.errors import AbortError
from tetractl.core.protocols import Actuator, Camera
from tetractl.core.setup import Setup
from tetractl.experiment.lab_section import ActuatorSection, CameraSection
from tetractl.kind_checks.finding import Finding, Findings

STARTED_S = 5.0  # time in which an opened camera must deliver two frames


def check_camera(section: CameraSection, setup: Setup) -> Findings:
    """Check that a camera can be built and, if it can be opened, that its frames are valid."""
    from threading import Event

    from tetractl.core.clock import MonotonicClock, seconds

    woken, clock = Event(), MonotonicClock()
    camera = section.build(setup, clock, woken.set)
    yield _members("camera", camera, Camera)
    try:
        with camera:
            yield Finding(
                "newest: a frame after opening", "" if camera.newest else "there is no frame"
            )
            until = clock.now() + STARTED_S * 1e9
            found = camera.frames()
            while len(found) < 5 and clock.now() < until:
                woken.wait(0.1)
                woken.clear()
                found += camera.frames()
            now = clock.now()
            if len(found) < 2:
                yield Finding("frames: at least 2", f"{len(found)} in {seconds(now):.0f} s")
                return
            numbers, times = [one.number for one in found], [one.sampled_ns for one in found]
            yield Finding(
                "frames: numbers rise", "" if numbers == sorted(set(numbers)) else str(numbers)
            )
            yield Finding("frames: times rise", "" if times == sorted(times) else str(times))
            late = [one for one in found if not one.sampled_ns <= one.received_ns <= now]
            yield Finding(
                "frames: received after their exposure",
                f"wrong for {len(late)} of {len(found)} frames" if late else "",
            )
            count = {len(one.poses) for one in found}
            robots = len(setup.names)
            wrong = "" if count == {robots} else f"numbers of poses: {sorted(count)}"
            yield Finding("frames: one pose per robot", wrong)
    except AbortError as error:
        yield Finding(f"not opened, so its frames are not checked ({error})")


def check_actuator(section: ActuatorSection, setup: Setup) -> Findings:
    """Check that an actuator can be built; nothing is opened or moved."""
    from tetractl.core.clock import MonotonicClock

    actuator = section.build(setup, MonotonicClock())
    yield _members("actuator", actuator, Actuator)
    yield Finding("period_ns: above 0", "" if actuator.period_ns > 0 else f"{actuator.period_ns}")
    for name in ("individual", "halts"):
        value = getattr(actuator, name)
        yield Finding(f"{name}: true or false", "" if isinstance(value, bool) else repr(value))
    yield Finding("failure: None before the device is opened", actuator.failure or "")
    contradictions = [
        f"{'.'.join(map(str, loc))} {text}" for loc, text in section.contradictions(setup)
    ]
    yield Finding("section: fits the spec's robots", "; ".join(contradictions))


def _members(what: str, device: Any, protocol: type) -> Finding:
    names = {name for base in protocol.__mro__ for name in vars(base) if not name.startswith("_")}
    names |= {"__enter__", "__exit__"}
    lacking = sorted(name for name in names if not hasattr(device, name))
    return Finding(f"{what}: all members", f"lacks {', '.join(lacking)}" if lacking else "")
