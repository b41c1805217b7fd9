import itertools
import math

import numpy as np
import pytest
from support.paths import ROOT
from support.plants import sim
from support.trials import experiment

from tetractl.core.clock import SECOND
from tetractl.core.commands import Steer
from tetractl.core.errors import SpecError
from tetractl.experiment.load import load_spec
from tetractl.experiment.plants import on_plant
from tetractl.run.spec_trial import run_trial
from tetractl.run.trial_limits import check, directions, limits

SQUARE = {"type": "square", "side": 2.0}


def heading(angle, **changes):
    robots = [robot.model_dump() | {"heading": angle} for robot in experiment().robots]
    return experiment(robots=robots, controller={"first_plan": SQUARE}, **changes)


@pytest.mark.parametrize("angle", [0.0, 1.0, -3.1, 3.1, 9.0])
def test_the_square_ends_where_it_began(angle):
    """To within about exp(-a side) of a side: the slowest robot turns with a = 3 rad/s."""
    simulated = sim(heading(angle))
    simulated.open()
    for lap in range(2):
        for k, direction in enumerate(directions(np.full(3, angle)), start=1):
            simulated.send(Steer(direction))
            simulated.clock.sleep_until(2 * (4 * lap + k) * SECOND)
    now = simulated.observe().poses
    starts = np.array([robot.start for robot in heading(angle).robots])
    side = 2.0 * np.array([robot.speed for robot in heading(angle).robots])
    assert np.all(np.hypot(*(now.xy - starts).T) < 3 * math.exp(-6) * side)
    off = [math.remainder(h - angle, 2 * math.pi) for h in now.heading]
    assert np.abs(off).max() < 3 * math.exp(-6)


def test_directions_turn_by_quarters_and_end_at_the_start_heading():
    sides = list(directions(np.array([3.0, 3.0 + 2 * math.pi])))
    assert len(sides) == 4
    assert all(abs(direction) <= math.pi for direction in sides)
    turns = [math.remainder(b - a, 2 * math.pi) for a, b in itertools.pairwise(sides)]
    assert turns == pytest.approx([math.pi / 2] * 3)
    assert sides[-1] == pytest.approx(3.0)


WIDE = {"left": -4000, "bottom": -4000, "width": 9000, "height": 9000}


def test_a_square_with_room_is_accepted():
    check(heading(0.0, arena=WIDE, obstacles=[]))
    check(experiment())  # no square at all


NARROW = {"left": 890, "bottom": 350, "width": 1600, "height": 1800}
DISC = {"type": "circle", "center": (800, 1700), "radius": 60}
CROSSED = [robot.model_dump() | {"heading": i} for i, robot in enumerate(experiment().robots)]


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        (heading(math.pi, arena=NARROW, obstacles=[]), "robot green would leave the arena"),
        (heading(0.0, arena=WIDE, obstacles=[DISC]), "robot blue would enter an obstacle"),
        (experiment(robots=CROSSED, controller={"first_plan": SQUARE}), "the same heading"),
    ],
)
def test_a_square_that_cannot_be_driven_is_refused(spec, message):
    with pytest.raises(SpecError, match=message) as caught:
        check(spec)
    assert caught.value.hint


def test_limits_say_what_a_trial_can_do_at_most():
    stated = limits(experiment(controller={"time_limit": 2, "first_plan": SQUARE}))
    assert stated["duration of a trial"].startswith("at most 2 s")
    assert stated["path of a robot"] == "at most 400 mm"
    assert stated["before step 0"] == "a square of 8 s"


def test_a_dry_run_in_the_lab_says_where_it_would_go_and_what_ends_it():
    slow = [f"lab.actuator.robots.{i}.limit=20" for i in range(3)]
    spec = ROOT / "experiments" / "three_m3pi_lab.yaml"
    stated = limits(on_plant(load_spec(spec, slow), "lab").experiment)
    assert stated["cameras"] == "192.168.1.10:1510, multicast"
    assert stated["radio"] == "/dev/ttyUSB0, 40 commands per second"
    assert stated["wheel counts"] == "at most 20 of 127"
    assert stated["all robots stop"].startswith("0.1 s")
    assert "cameras" not in limits(load_spec(spec).experiment)


@pytest.mark.long
def test_the_gap_of_the_square_is_not_believed_to_be_motion(tmp_path):
    """The robots are back at their start after 6 s: the way between is 0, the speed is not."""
    square = ("first_plan.type=square", "first_plan.side=1.5", "estimate=true")
    sets = [f"controller.{setting}" for setting in square]
    spec = load_spec(ROOT / "experiments" / "three_m3pi.yaml", sets)
    result = run_trial(spec, tmp_path)
    assert result.total_error < 1
    assert not result.entered_obstacle
