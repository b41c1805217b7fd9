"""Tests that `tetractl_testing` and `tetractl kinds --check` find every fault of a kind."""

import re
import shutil
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Literal

import numpy as np
import pytest
from pydantic import PrivateAttr, model_validator
from testkit.cli import tetractl
from testkit.paths import ROOT
from testkit.trials import experiment
from testkit.usage import command_of, refused_in_one_line
from tetractl_testing import (
    check_actuator,
    check_camera,
    check_controller,
    check_disturbance,
    check_kind,
    check_optimizer,
    check_shape,
    findings_of,
)
from tetractl_testing.device_checks import _check_leaving

from tetractl.cli.specs import build_template
from tetractl.control.methods.sequence import SequenceSection
from tetractl.control.search.optimizers.pso import Pso
from tetractl.core.clock import SECOND
from tetractl.core.commands import Stop, Transmission
from tetractl.core.errors import UsageError
from tetractl.core.plan import Plan
from tetractl.core.poses import Poses
from tetractl.core.protocols import Health
from tetractl.core.registries import MOTIONS
from tetractl.core.shape import Shape
from tetractl.lab.actuators.twist import line_ports
from tetractl.lab.actuators.twist.section import TwistSection
from tetractl.lab.serial_port import SerialPort
from tetractl.plant.disturbances.radio import RadioSection
from tetractl.spec.base import Positive
from tetractl.spec.disturbance import Disturbance, DisturbanceSection
from tetractl.spec.experiment import ShapeSection
from tetractl.spec.lab_section import ActuatorSection, CameraSection
from tetractl.spec.load import parse_spec

SETUP = parse_spec(build_template("check", "check"), "check").experiment.setup
EXACT = MOTIONS.load("exact")
USAGE = """
kinds --check nowhere:X | nowhere:X: cannot be imported: ModuleNotFoundError
kinds --check json | json: write it as MODULE:NAME | for example pivot:PIVOT
kinds --check : | :: write it as MODULE:NAME | for example pivot:PIVOT
kinds --check json:dumps --set =3 | --set =3: write it as FIELD=VALUE
kinds --check json:dumps | json:dumps: there is no check for an object of this kind
kinds --check tetractl.model.shapes:Circle | Circle: center: is missing
kinds --check tetractl.control.search.stop:PaperStop | PaperStop: there is no check for an object
"""


def wrong(check, *args):
    """What a check finds wrong, of which the first is what it raises."""
    problems = [finding for finding in findings_of(partial(check, *args)) if finding.problem]
    if problems:
        with pytest.raises(AssertionError, match=f"^{re.escape(problems[0].what)}: "):
            check(*args)
    return [finding.what for finding in problems]


def compiled(**methods):
    """The exact motion with some functions of its compiled class replaced."""

    changed = {name: staticmethod(f(EXACT.lanes)) for name, f in methods.items()}
    return replace(EXACT, lanes=type("Other", (EXACT.lanes,), changed))


def scaled(row, place, factor):
    def change(correct):
        def differentiate(*args):
            *in_rows, by_parameters = correct.differentiate(*args)
            derivatives = np.array(in_rows)
            derivatives[row, place] *= factor
            return *derivatives, by_parameters

        return differentiate

    return change


def drifting(*args):
    x, y, heading = EXACT.step(*args)
    return x + np.random.default_rng().normal(size=x.shape), y, heading


def northward(x, y, heading, u, a, v, t):
    moved = EXACT.step(x, y, heading, u, a, v, t)
    return moved[0], y + 0.9 * (moved[1] - y), moved[2]


@pytest.mark.parametrize(
    ("motion", "what"),
    [
        (replace(EXACT, step=drifting), "step: repeats exactly"),
        (replace(EXACT, step=northward), "step: the motion turns with heading and u"),
        (
            replace(EXACT, hold=lambda x, y, h, held, a, v, t: (x, y, h)),
            "hold: gives the same x as step",
        ),
        (
            compiled(advance=lambda correct: lambda x, y, c, s, cu, su, k: (x, y, c, s)),
            "advance: gives the same x as step",
        ),
        (compiled(differentiate=scaled(0, 0, 1.01)), "differentiate: gives the same dx as step"),
        (compiled(differentiate=scaled(1, 0, 1.01)), "differentiate: d(dx)/dheading"),
        (compiled(differentiate=scaled(2, 1, -1)), "differentiate: d(dy)/du"),
        (compiled(differentiate=scaled(2, 2, 1.01)), "differentiate: d(heading')/du"),
        (replace(EXACT, step=lambda *args: args[9]), "runs"),
    ],
)
def test_what_is_wrong_with_a_motion_is_found(motion, what):
    """The last one raises, and is reported at its line."""
    module = type("module", (), {"MOTION": motion})
    with pytest.MonkeyPatch.context() as patched:
        patched.setitem(__import__("sys").modules, "mine", module)
        assert what in [
            finding.what for finding in check_kind("mine:MOTION", {}, SETUP) if finding.problem
        ]


class Sketch(ShapeSection):
    """A shape that is given by its corners."""

    type: Literal["sketch"] = "sketch"
    corners: tuple[tuple[float, float], ...]
    radius: float = 0.0

    def shape(self):
        return Shape(np.array(self.corners), self.radius)


class Untyped(ShapeSection):
    """A shape whose author forgot its name."""

    radius: float = 0.0


del Untyped.model_fields["type"]


@pytest.mark.parametrize(
    ("corners", "radius", "what"),
    [
        (((0, 0), (0, 2), (2, 2)), 0, "outline: anticlockwise"),
        (((0, 0), (2, 0), (0, 2), (2, 2)), 0, "corners: edges do not cross"),
        (((0, 0), (4, 0), (4, 4), (3, 1)), 1, "corners: are convex if there is a radius"),
        (((0, 0), (4, 0), (4, 4)), -1, "radius: finite, at least 0"),
        ((), 1, "corners: an array (K, 2)"),
    ],
)
def test_what_is_wrong_with_a_shape_is_found(corners, radius, what):
    problems = wrong(check_shape, Sketch(corners=corners, radius=radius), SETUP)
    assert any(problem.startswith(what) for problem in problems)


class Other(Pso):
    """An optimiser that is one with a fault."""

    fault: str = ""
    _calls: Iterator[int] = PrivateAttr(default_factory=count)

    def search(self, problem, length, warm, key, limits):
        if self.fault == "key":
            key += next(self._calls)
        if self.fault == "warm" and warm is not None:
            warm[0] = 0.5
        if self.fault == "budget":
            limits = replace(limits, evaluations=None)
        search = super().search(problem, length, warm, key, limits)
        return replace(search, cost=0.9 * search.cost) if self.fault == "cost" else search


@pytest.mark.parametrize(
    ("fault", "what"),
    [
        ("", None),
        ("key", "12 signals: the same key gives the same search"),
        ("warm", "12 signals, warm start: not changed"),
        ("budget", "12 signals: evaluations: in budget"),
        ("cost", "12 signals: cost: equals J of signals"),
    ],
)
def test_what_is_wrong_with_an_optimiser_is_found(fault, what):
    optimizer = Other(type="pso", iterations=6, particles=12, fault=fault)
    problems = wrong(check_optimizer, optimizer, SETUP)
    if what:
        assert what in problems
    else:
        assert problems == []


class Faulty(SequenceSection):
    """A controller with a fault; `build` returns itself."""

    fault: str
    _inner: object = PrivateAttr()

    def build(self, setup, key, host=None):
        self._inner = super().build(setup, key)
        return self

    def plan(self, observation, last_command=None, earlier=()):
        plan = self._inner.plan(observation, last_command)
        signals = None
        if not isinstance(plan, Plan):
            return None if self.fault == "end" else plan
        if self.fault == "random":
            signals = np.random.random(plan.signals.shape)  # noqa: NPY002
        elif self.fault == "random number":
            return replace(plan, numbers={"margin_mm": np.random.random()})  # noqa: NPY002
        elif self.fault == "clock":
            signals = np.full_like(plan.signals, time.perf_counter() % 1)
        elif self.fault == "nan":
            signals = np.full(1, np.nan)
        return plan if signals is None else replace(plan, signals=signals)


@pytest.mark.parametrize(
    ("fault", "what"),
    [
        ("end", "plan: returns a Plan, an Outcome or an End that can be sent and logged"),
        ("random", "random numbers: come only from the key"),
        ("random", "key: the same key gives the same decisions"),
        ("random number", "key: the same key gives the same decisions"),
        ("clock", "clock: reads only `timer`"),
        ("nan", "plan: returns a Plan, an Outcome or an End that can be sent and logged"),
    ],
)
def test_what_is_wrong_with_a_controller_is_found(fault, what):
    section = Faulty(type="sequence", directions=(0.1,) * 9, fault=fault)
    assert what in wrong(check_controller, section, SETUP)


class Ill(DisturbanceSection):
    """A disturbance with a fault."""

    type: Literal["ill"] = "ill"
    fault: str

    def build(self, setup, rng):
        return IllOne(self.fault)


class IllOne(Disturbance):
    def __init__(self, fault):
        self.fault = fault

    def moved(self, poses, moving, seconds, time_s):
        x = poses.x + 1.0 if self.fault == "at once" else poses.x
        if self.fault == "in place":
            poses.x[:] += seconds
        return Poses(x, poses.y, poses.heading)

    def varied(self, a, speed, time_s):
        if self.fault == "random":
            return a * np.random.default_rng().uniform(), speed
        return -a if self.fault == "negative" else a, speed

    def received(self, exposed_ns, received_ns):
        return None if self.fault == "lost" else received_ns


@pytest.mark.parametrize(
    ("fault", "what"),
    [
        ("at once", "moved: finite, and unchanged if no time passes"),
        ("in place", "moved: does not change its arguments"),
        ("random", "varied: the same seed gives the same results"),
        ("negative", "varied: finite, at least 0, shape (N,)"),
        ("lost", "received: not before the exposure, and None only if loses_frames is set"),
    ],
)
def test_what_is_wrong_with_a_disturbance_is_found(fault, what):
    assert wrong(check_disturbance, Ill(fault=fault), SETUP) == [what]


class FakeCameraSection(CameraSection):
    """A camera made for the test."""

    type: Literal["fake"]
    period: Positive = 1.0

    def build(self, setup, clock, wake):
        return FakeCamera()


class FakeCamera:
    """Without frames, and without `damaged`."""

    def __enter__(self):
        raise __import__("tetractl").core.errors.AbortError("no camera answers")

    def __exit__(self, *_):
        pass

    def check(self):
        return Health((), {})

    def frames(self):
        return []


class FakeActuatorSection(ActuatorSection):
    """An actuator that lacks everything."""

    type: Literal["fake"]

    def build(self, setup, clock):
        return type("Nothing", (), {"period_ns": 0, "halts": 1, "failure": None})()


def test_what_is_wrong_with_a_device_is_found_and_nothing_moves():
    of_camera = findings_of(partial(check_camera, FakeCameraSection(type="fake"), SETUP))
    assert of_camera[0].problem == "lacks damaged"
    assert (
        of_camera[1].what
        == "the camera was not opened, so its frames were not checked (no camera answers)"
    )
    of_actuator = findings_of(partial(check_actuator, FakeActuatorSection(type="fake"), SETUP))
    assert of_actuator[1].problem == "lacks __enter__, __exit__, check, poll, send, stop"
    problems = wrong(check_actuator, FakeActuatorSection(type="fake"), SETUP)
    assert problems[1:] == ["period_ns: above 0", "halts: is true or false"]


class PortSection(ActuatorSection):
    """An actuator that writes text to a port."""

    type: Literal["port"] = "port"
    port: str = "nowhere"
    divisor: float = 1.0

    def build(self, setup, clock):
        return PortActuator(self, setup, clock)


class PortActuator:
    """Stands for an actuator of robots that cannot stop: it writes directions to a port."""

    halts = False
    period_ns = 10**7
    failure = None

    def __init__(self, section, setup, clock):
        self.section = section
        self.setup = setup
        self.clock = clock

    def __enter__(self):
        self.port = Path(self.section.port).open("w", encoding="ascii")
        return self

    def __exit__(self, *_):
        self.port.close()

    def check(self):
        return Health()

    def poll(self, timeout_s):
        return []

    def send(self, action, poses, moving, exposed_ns):
        headings = np.array([0.0 if pose is None else pose.heading for pose in poses])
        print(action.direction / self.section.divisor, file=self.port, flush=True)
        turning = self.setup.a * np.sin(action.direction - headings)
        now_ns = self.clock.now()
        speed = self.setup.speed
        return Transmission(action, now_ns, tuple(moving), speed=speed, turning=turning)

    def stop(self, emergency=False):
        print("off" * 10_000, file=self.port, flush=True)  # more than the port holds
        zeros = np.zeros(len(self.setup.names))
        all_robots = (True,) * zeros.size
        return Transmission(Stop(), self.clock.now(), all_robots, speed=zeros, turning=zeros)


def test_an_actuator_sends_to_a_port_behind_which_nothing_is():
    check_actuator(PortSection(), SETUP)
    assert len(findings_of(partial(check_actuator, PortSection(), SETUP))) == 15
    with pytest.raises(ZeroDivisionError):
        check_actuator(PortSection(divisor=0.0), SETUP)


@pytest.mark.parametrize("later_s", [-1.5, 0.5])
def test_a_command_that_was_not_sent_when_it_says_is_found(later_s):
    """A defect planted in `device_checks.py`, of commands that are old, was found by no test."""

    class LateSection(PortSection):
        def build(self, setup, clock):
            later = round(later_s * SECOND)
            shifted = SimpleNamespace(now=lambda: clock.now() + later)
            return PortActuator(self, setup, shifted)

    assert "steer: is sent at once" in wrong(check_actuator, LateSection(), SETUP)


def test_a_kind_is_checked_with_the_robots_of_a_spec(tmp_path):
    shutil.copy(ROOT / "experiments" / "single_cell.yaml", tmp_path / "one.yaml")
    words = ("kinds", "--check", "tetractl.control.methods.sequence:SequenceSection", "--json")
    words += ("--set", "directions=[0.5]")
    done = tetractl(tmp_path, *words, "--spec", "one.yaml")
    assert done.returncode in (0, 1), done.stderr
    done = tetractl(tmp_path, "kinds", "--spec", "one.yaml")
    assert (done.returncode, "together with --check" in done.stderr) == (2, True)
    done = tetractl(tmp_path, *words, "--spec", "none.yaml")
    assert (done.returncode, "none.yaml" in done.stderr) == (2, True)
    words = ("init", "robots", "--lab", "--robots", "twist", "--camera", "optitrack")
    tetractl(tmp_path, *words).ok()
    code = "tetractl.lab.actuators.twist.section:TwistSection"
    done = tetractl(tmp_path, "kinds", "--check", code, "--spec", "robots.yaml")
    assert (done.returncode, done.stderr) == (0, "")  # `robots` and `port` are the spec's


@pytest.mark.parametrize("row", USAGE.strip().splitlines(), ids=command_of)
def test_what_cannot_be_checked_is_one_line(tmp_path, row):
    refused_in_one_line(tmp_path, 2, row)


def test_the_command_says_what_was_checked(tmp_path):
    done = tetractl(tmp_path, "kinds", "--check", "tetractl.model.motion.euler:EULER")
    assert (done.returncode, done.stderr) == (0, "")
    assert "ok     advance: gives the same x as step" in done.stdout.splitlines()
    assert done.stdout.endswith("tetractl.model.motion.euler:EULER: 0 of 27 checks failed\n")
    (tmp_path / "mine.py").write_text(
        "from dataclasses import replace\nfrom tetractl.model.motion.exact import EXACT\n"
        "MINE = replace(EXACT, step=lambda x, y, h, u, a, v, t: (x + v * t, y, h + 0 * u))\n"
    )
    done = tetractl(tmp_path, "kinds", "--check", "mine:MINE")
    assert done.returncode == 1
    assert "WRONG  step: the motion turns with heading and u" in done.stdout


class Contradictory(Sketch):
    """A shape whose fields contradict each other."""

    @model_validator(mode="after")
    def _never(self):
        raise ValueError("its fields contradict each other")


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        (Untyped, "mine:KIND: the field `type` must be a Literal with a single name"),
        (Contradictory, "mine:KIND: its fields contradict each other"),
    ],
)
def test_a_section_that_cannot_be_made_is_one_line(monkeypatch, kind, told):
    """Regression: without `type` a KeyError, and a rule of all fields was reported of none."""
    module = type("module", (), {"KIND": kind})
    monkeypatch.setitem(__import__("sys").modules, "mine", module)
    with pytest.raises(UsageError) as caught:
        check_kind("mine:KIND", {"corners": ()}, SETUP)
    assert caught.value.message == told


def test_nothing_is_sent_to_the_port_of_a_network():
    """Regression: it was given the name of a pseudo-terminal, on which it failed."""

    class NetworkSection(PortSection):
        port: int = 9001

    findings = findings_of(partial(check_actuator, NetworkSection(), SETUP))
    assert not any(finding.problem for finding in findings)
    assert findings[-1].what.startswith("send: not checked")


def test_robots_with_ports_of_their_own_are_not_steered_there(monkeypatch):
    """Regression: the lines to such a robot went to its own port, and it drove."""
    opened = set()

    class NotedPort(SerialPort):
        def open(self, alone=True):
            opened.add(self._name)
            super().open(alone)

    monkeypatch.setattr(line_ports, "open_port", NotedPort)
    robots = [{"name": name, "radius_mm": 40.0, "port": f"/dev/{name}"} for name in SETUP.names]
    section = TwistSection.model_validate({"type": "twist", "port": "/dev/none", "robots": robots})
    check_actuator(section, SETUP)
    assert len(opened) == 1
    assert opened.isdisjoint({"/dev/none", *(robot["port"] for robot in robots)})


def test_closing_before_opening_is_a_finding():
    """Regression: it ended in a traceback."""
    unopened = PortActuator(PortSection(), SETUP, None)
    (finding,) = findings_of(partial(_check_leaving, unopened, unopened))
    assert finding.problem == "AttributeError: 'PortActuator' object has no attribute 'port'"


def test_a_radio_that_delays_each_robot_on_its_own_passes_its_checks():
    radio = RadioSection(type="radio", spread=0.1)
    of_three = experiment().setup
    assert len(of_three.names) == 3
    assert wrong(check_disturbance, radio, of_three) == []
