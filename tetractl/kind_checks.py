"""Checks a kind of another package against tetractl's requirements: `tetractl kinds --check`.

Each check is a generator of findings. Random numbers come from a fixed seed, so findings repeat.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np
from pydantic import ValidationError

from tetractl.core.errors import AbortError, UsageError
from tetractl.core.plan import Limits, Problem
from tetractl.core.poses import Floats
from tetractl.core.protocols import Actuator, Camera
from tetractl.core.setup import Setup
from tetractl.experiment.base import Model
from tetractl.experiment.controller import OptimizerSection
from tetractl.experiment.lab_section import ActuatorSection, CameraSection
from tetractl.experiment.shape_section import ShapeSection
from tetractl.experiment.yaml.explain import words
from tetractl.model.motion.motion import Held, Motion
from tetractl.model.obstacles import Obstacles

SEED = 20
COUNT = 200  # number of random cases per check
NEAR = 1e-6  # relative error up to which two results agree
STEP = 1e-6  # step of a central difference [rad]
SLOPE = 1e-4  # relative error up to which a derivative agrees with a central difference
STARTED_S = 5.0  # time in which an opened camera must deliver two frames


@dataclass(frozen=True, slots=True)
class Finding:
    """The description of a check, and its error, "" for none."""

    what: str
    problem: str = ""


Findings = Iterator[Finding]


def check_kind(code: str, fields: Mapping[str, Any], setup: Setup) -> Findings:
    """Check "module:attribute": a Motion, or the section of a shape, optimiser or lab device.

    `fields` are the section's fields, and `setup` describes the robots of the experiment. Raises
    UsageError if the object cannot be imported or is something else.
    """
    module, _, attribute = code.partition(":")
    try:
        found = getattr(import_module(module), attribute)
    except Exception as error:
        raise UsageError(f"{code}: cannot be imported: {type(error).__name__}: {error}") from None
    if isinstance(found, Motion):
        return _guarded(partial(check_motion, found))
    if not (isinstance(found, type) and issubclass(found, Model)):
        raise UsageError(
            f"{code}: is neither a Motion nor a section of a shape, optimiser, camera or actuator"
        )
    for base, check in CHECKS.items():
        if issubclass(found, base):
            return _guarded(partial(check, _section(code, found, fields), setup))
    raise UsageError(
        f"{code}: there is no check for this kind", f"kinds with a check: {_and(CHECKS)}"
    )


def _and(kinds: Mapping[type, Any]) -> str:
    return ", ".join(kind.__name__ for kind in kinds) + " and Motion"


def _section(code: str, kind: type[Model], fields: Mapping[str, Any]) -> Any:
    named = kind.model_fields["type"].annotation
    options = getattr(named, "__args__", ())
    if len(options) != 1:
        raise UsageError(f"{code}: the field `type` must be a Literal with one name")
    try:
        return kind.model_validate({"type": options[0], **fields})
    except ValidationError as error:
        details = error.errors()[0]
        where = ".".join(map(str, details["loc"]))
        text = words(details, details["input"])
        raise UsageError(
            f"{code}: {where}: {text}", f"give the value by --set {where}=VALUE"
        ) from None


def _guarded(check: Callable[[], Findings]) -> Findings:
    """Yield the findings; an exception in the kind's own code becomes the last finding."""
    try:
        yield from check()
    except UsageError:
        raise
    except Exception as error:
        frame = error.__traceback__
        while frame is not None and frame.tb_next is not None:
            frame = frame.tb_next
        place = f"{frame.tb_frame.f_code.co_filename}:{frame.tb_lineno}: " if frame else ""
        yield Finding("runs", f"{place}{type(error).__name__}: {error}")


def _near(what: str, ours: Any, theirs: Any, scale: Any, share: float = NEAR) -> Finding:
    """Check that two results differ by at most `share` times `scale`; the error names the case
    that differs most."""
    ours, theirs, scale = np.broadcast_arrays(
        *(np.asarray(v, float) for v in (ours, theirs, scale))
    )
    off = np.abs(ours - theirs) / np.maximum(scale, 1e-300)
    worst = int(np.argmax(np.where(np.isfinite(off), off, np.inf)))
    if off.ravel()[worst] <= share:
        return Finding(what)
    values = f"{ours.ravel()[worst]:.9g} and {theirs.ravel()[worst]:.9g}"
    return Finding(what, f"{values} in case {worst} of {off.size}")


def _true(what: str, good: Any, problem: str) -> Finding:
    bad = np.flatnonzero(~np.asarray(good, bool).ravel())
    return Finding(what, f"{problem} in case {bad[0]} of {np.size(good)}" if bad.size else "")


def _same(what: str, one: Any, other: Any) -> Finding:
    alike = all(np.array_equal(a, b, equal_nan=True) for a, b in zip(one, other, strict=True))
    return Finding(what, "" if alike else "differs bit for bit")


def check_motion(motion: Motion) -> Findings:
    """Check the NumPy step, the plant's `hold`, the compiled step and its derivatives."""
    rng = np.random.default_rng(SEED)
    x, y = rng.uniform(-500, 500, (2, COUNT))
    heading, u = rng.uniform(-math.pi, math.pi, (2, COUNT))
    a, v, t = rng.uniform(0.5, 6, COUNT), rng.uniform(10, 300, COUNT), 0.2
    case = (x, y, heading, u, a, v)
    moved = motion.step(*case, t)
    yield _true("step: finite", np.isfinite(moved), "a pose is not finite")
    yield _same("step: repeats exactly", moved, motion.step(*case, t))
    gone = np.hypot(moved[0] - x, moved[1] - y)
    yield _true("step: moves by <= v t", gone <= v * t * (1 + NEAR), "a robot moves further")
    still = motion.step(*case, 0.0)
    yield _near("step: keeps x, y if t = 0", np.hypot(still[0] - x, still[1] - y), 0.0, v * t)
    turned = motion.step(x, y, heading + 1.0, u + 1.0, a, v, t)
    angle = np.arctan2(moved[1] - y, moved[0] - x) + 1.0
    yield _near("step: turns with heading and u", turned[0] - x, gone * np.cos(angle), v * t)
    if motion.turn is not None:
        yield _same("turn: same headings as step", [motion.turn(heading, u, a, t)], moved[2:])
    if motion.strides is not None:
        parts = motion.strides(heading, u, a, v, t)
        added = (_add(x, parts[0]), _add(y, parts[1]), heading + parts[2])
        yield _same("strides: their sum is the result of step", added, moved)
    held = Held(u, a * np.sin(u - heading), heading, np.ones(COUNT))
    whole = np.full(COUNT, t)
    driven = motion.hold(x, y, heading, held, a, v, whole)
    for name, one, other in zip("xy", driven, moved, strict=False):
        yield _near(f"hold: same {name} as step", one, other, v * t)
    resting = Held(u, 0 * u, heading, np.zeros(COUNT))
    stood = motion.hold(x, y, heading, resting, a, 0 * v, whole)
    yield _near("hold: does not move a stopped robot", np.hypot(stood[0] - x, stood[1] - y), 0, v)
    compiled = motion.lanes(a, t)
    yield from _check_advance(compiled, case, moved, t)
    yield from _check_derivatives(motion, compiled, case, moved, t)


def _add(start: Floats, terms: tuple[Floats, ...]) -> Floats:
    for term in terms:
        start = start + term
    return start


def _check_advance(compiled: Any, case: Any, moved: Any, t: float) -> Findings:
    x, y, heading, u, a, v = case
    constants = compiled.of(a, v, t)
    if constants.rows.shape != (COUNT, constants.size):
        yield Finding("advance: rows", f"have shape {constants.rows.shape}, not (N, size)")
        return
    found = []
    for i in range(COUNT):
        state = (x[i], y[i], math.cos(heading[i]), math.sin(heading[i]))
        for _ in range(constants.pieces):
            state = constants.advance(*state, math.cos(u[i]), math.sin(u[i]), constants.rows[i])
        found.append(state)
    ends = np.array(found, dtype=float).T
    yield _near("advance: same x as step", ends[0], moved[0], v * t)
    yield _near("advance: same y as step", ends[1], moved[1], v * t)
    yield _near("advance: same cos(heading) as step", ends[2], np.cos(moved[2]), 1.0)
    yield _near("advance: same sin(heading) as step", ends[3], np.sin(moved[2]), 1.0)


def _check_derivatives(motion: Motion, compiled: Any, case: Any, moved: Any, t: float) -> Findings:
    x, y, heading, u, a, v = case
    cos_sin = (np.cos(heading), np.sin(heading), np.cos(u), np.sin(u))
    cases = np.column_stack([*cos_sin, a, v]).tolist()
    found = np.array([compiled.differentiate(*one, t) for one in cases]).T
    change = np.remainder(moved[2] - heading + math.pi, math.tau) - math.pi
    turn = np.remainder(found[2] - change + math.pi, math.tau) - math.pi
    yield _near("differentiate: same dx as step", found[0], moved[0] - x, v * t)
    yield _near("differentiate: same dy as step", found[1], moved[1] - y, v * t)
    yield _near("differentiate: same dheading as step", turn, 0.0, 1.0)

    def slope(by_heading: float, by_u: float) -> Any:
        ends = [
            motion.step(x, y, heading + sign * by_heading, u + sign * by_u, a, v, t)
            for sign in (0.5, -0.5)
        ]
        return [(one - other) / STEP for one, other in zip(*ends, strict=True)]

    by_heading, by_u = slope(STEP, 0.0), slope(0.0, STEP)
    for name, ours, theirs, scale in (
        ("d(dx)/dheading", found[3], by_heading[0], v * t),
        ("d(dy)/dheading", found[4], by_heading[1], v * t),
        ("d(dx)/du", found[5], by_u[0], v * t),
        ("d(dy)/du", found[6], by_u[1], v * t),
        ("d(heading')/dheading", found[7], by_heading[2], 1.0),
        ("d(heading')/du", 1.0 - found[7], by_u[2], 1.0),
    ):
        yield _near(f"differentiate: {name}", ours, theirs, scale, SLOPE)


def check_shape(shape: ShapeSection, setup: Setup) -> Findings:
    """Check the NumPy geometry of a shape against its outline and its compiled functions."""
    corners = shape.outline()
    size = float(np.ptp(corners, axis=0).max())
    rng = np.random.default_rng(SEED)
    low, high = corners.min(axis=0) - size / 2, corners.max(axis=0) + size / 2
    x, y, x1, y1 = (rng.uniform(low[i % 2], high[i % 2], COUNT) for i in range(4))
    rolled = np.roll(corners, -1, axis=0)
    area = 0.5 * float(np.sum(corners[:, 0] * rolled[:, 1] - rolled[:, 0] * corners[:, 1]))
    yield _true("outline: anticlockwise", area > 0, "encloses no area, or runs clockwise")
    yield _near("outline: corners at distance 0", shape.distance(*corners.T), 0.0, size)
    for margin in (0.0, size / 10):
        grown = shape.grown(margin)
        what = "grown: " if margin else ""
        inside, gap = grown.contain(x, y), grown.distance(x, y)
        clear = np.abs(gap) > NEAR * size  # closer to the edge, rounding decides
        yield _true(
            f"{what}contain: true where distance <= 0", (inside == (gap <= 0)) | ~clear, "differs"
        )
        met = grown.cross(x, y, x1, y1)
        ends = inside | grown.contain(x1, y1)
        yield _true(f"{what}cross: true for segments with an end inside", met | ~ends, "false")
        along = np.linspace(0, 1, 50)[:, None]
        seen = grown.distance(x + along * (x1 - x), y + along * (y1 - y)).min(axis=0)
        yield _true(
            f"{what}cross: true for segments through the shape",
            met | (seen > -NEAR * size),
            "false",
        )
        length = np.hypot(x1 - x, y1 - y)
        yield _true(f"{what}cross: false for segments outside", ~met | (seen < length / 50), "true")
        yield from _check_packed(what, grown, size, (x, y, x1, y1), gap, met, clear)
    margin = size / 10
    gap, nearer = (one.distance(x, y) for one in (shape, shape.grown(margin)))
    fits = np.abs(gap - nearer - margin) <= margin / 2  # a grown corner may be sharp
    yield _true("grown: edge moved by the margin", (gap < 2 * margin) | fits, "differs")


def _check_packed(
    what: str, shape: Any, size: float, points: Any, gap: Any, met: Any, clear: Any
) -> Findings:
    packed, row = shape.packed, tuple(map(float, shape.row()))
    rows = np.asarray(row) if packed.size is None else row
    if packed.size not in (None, len(row)):
        yield Finding(f"{what}packed: size", f"is {packed.size}, but row has {len(row)} numbers")
        return
    cases = [tuple(map(float, case)) for case in zip(*points, strict=True)]
    inside = np.array([packed.gap(px, py, rows) <= 0 for px, py, _, _ in cases])
    yield _true(f"{what}packed.gap: at most 0 inside", (inside == (gap <= 0)) | ~clear, "differs")
    between = np.array([packed.gap_between(*case, rows) <= 0 for case in cases])
    yield _true(f"{what}packed.gap_between: <= 0 where cross is true", between == met, "differs")
    deep = gap < -NEAR * size
    depth = np.array([packed.depth(px, py, rows) for px, py, _, _ in cases])
    yield _near(f"{what}packed.depth: equals -distance inside", depth[deep], -gap[deep], size)
    out = np.array([packed.outward(px, py, rows) for px, py, _, _ in cases])
    yield _near(f"{what}packed.outward: a unit vector", np.hypot(*out.T)[deep], 1.0, 1.0)


def check_optimizer(optimizer: OptimizerSection, setup: Setup) -> Findings:
    """Check that an optimiser's search records are consistent, and that its searches repeat."""
    from tetractl.control.evaluate import compiled_costs

    problem = Problem(
        poses=setup.starts, targets=setup.targets, a=setup.a, speed=setup.speed, motion="exact",
        period=0.2, first_period=0.2, obstacles=Obstacles.of(setup.obstacles),
        obstacle_weight=1000.0, swept=True,
    )  # fmt: skip
    rng = np.random.default_rng(SEED)
    for length in (1, 12):
        for warm in (None, rng.uniform(-math.pi, math.pi, length)):
            kept, what = None if warm is None else warm.copy(), f"{length} signals: "
            found = optimizer.search(problem, length, warm, SEED, Limits())
            again = optimizer.search(problem, length, warm, SEED, Limits())
            if warm is not None:
                what = f"{length} signals, warm start: "
                yield _same(f"{what}not changed", [warm], [kept])
            shape = np.shape(found.signals)
            if shape != (length,):
                yield Finding(f"{what}signals", f"have shape {shape}, not ({length},)")
                return
            pair = [(one.signals, one.history, one.evaluations) for one in (found, again)]
            yield _same(f"{what}same search for the same key", *pair)
            cost = float(compiled_costs(problem, 1)(found.signals[:, None])[0])
            yield _near(f"{what}cost: equals J of signals", found.cost, cost, max(abs(cost), 1e-9))
            yield _near(f"{what}history: ends with cost", found.history[-1], found.cost, 1 + cost)
            yield _true(f"{what}history: never rises", np.diff(found.history) <= 0, "it rises")
            yield _true(f"{what}evaluations: at least 1", found.evaluations >= 1, "there are none")
            if optimizer.evaluations_max is not None:
                fits = found.evaluations <= optimizer.evaluations_max
                yield _true(
                    f"{what}evaluations: at most evaluations_max", fits, str(found.evaluations)
                )
            budget = optimizer.evaluations_min + 5
            spent = optimizer.search(problem, length, warm, SEED, Limits(budget)).evaluations
            yield _true(f"{what}evaluations: in budget", spent <= budget, f"{spent} of {budget}")


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


CHECKS: Mapping[type, Callable[[Any, Setup], Findings]] = {
    ShapeSection: check_shape,
    OptimizerSection: check_optimizer,
    CameraSection: check_camera,
    ActuatorSection: check_actuator,
}
