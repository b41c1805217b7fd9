"""Each sentence of cells is broken by a record in which it does not hold, and by none in which it
does.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from support.paths import EXAMPLES
from tetractl_emulator.rehearsal.cell_sentences import (
    DishTruth,
    _identity,
    _result,
    cell_violations,
)
from tetractl_emulator.rehearsal.day import Day, DayPlan
from tetractl_emulator.rehearsal.picture_faults import microscope_rows

from tetractl.core.plan import Outcome
from tetractl.experiment.load import load_spec
from tetractl.log.read.trial_log import TrialLog

EXPERIMENT = load_spec(EXAMPLES / "tetrahymena_dish.yaml").experiment
LIMITS = EXPERIMENT.lab.limits
STARTS = [[1.0, 1.0, 0.0], [2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [2.0, 2.0, 0.0]]
DARK = {"kind": "dark", "strength": 0.5, "fault": "light", "share": 0.1, "at": 1.0}
KEY = {"kind": "dark", "strength": 0.5, "fault": "emergency", "at": 1.0}
ERROR = "error: trial 1: cell 1 is not tracked (0.70 s)\n"


def at(seconds, event, **facts):
    return {"t_ns": round(seconds * 1e9), "event": event, **facts}


def truth_at(seconds, amperes=0.0, poses=STARTS):
    return at(seconds, "truth", frame=0, poses=poses, currents_a=[amperes, 0.0])


def command(seconds, flags=1, unseen=60.0):
    currents = [500 * (flags & 1), 0]
    return at(seconds, "command", flags=flags, currents_ma=currents, unseen_ms=[unseen] * 4)


RUN = [
    at(0.5, "run"),
    command(0.5, unseen=500.0),  # the field turns before the choice
    at(1.0, "guard", state="run", reason=""),
    command(1.0),
    truth_at(1.0, 0.5),
]
SEEN = at(2.0, "fault", phase="start", name="light", row=0)
STOP = at(3.0, "guard", state="abort", reason="cell 1 is not tracked (0.70 s)")


def truth_of(*events, fault=DARK, said=ERROR):
    events = sorted([*RUN, *events], key=lambda event: event["t_ns"])
    plan = DayPlan(1, {}, [fault], "", [*microscope_rows()])
    return DishTruth(Day(plan, events, 1, said, None, "", 1.0), EXPERIMENT.setup, LIMITS, 0.25)


def found(*events, **more):
    names = {
        cell_violation.name
        for cell_violation in cell_violations(truth_of(*events, **more), EXPERIMENT.lab)
    }
    return names - {"log"}


def test_a_good_end_breaks_nothing():
    assert not found(SEEN, STOP, command(2.9), command(3.0, 0), truth_at(3.0, 0.5), truth_at(3.4))


@pytest.mark.parametrize(
    ("name", "events", "more"),
    [
        ("driven blind", [SEEN, STOP, command(2.1, unseen=350.0)], {}),
        ("driven blind", [command(0.6, unseen=700.0), SEEN, STOP], {}),
        ("not at rest", [SEEN, STOP, command(3.1)], {}),
        ("not at rest", [SEEN, STOP, command(3.0), truth_at(3.4, 0.5)], {}),
        ("not at rest", [SEEN, STOP, truth_at(1.5, 0.5)], {}),
        ("reason", [SEEN, STOP], {"said": "error: trial 1: the moon is full\n"}),
        (
            "not at rest",
            [at(2.0, "fault", phase="start", name="emergency", row=0), STOP, command(2.1, 0)],
            {"fault": KEY},
        ),
    ],
)
def test_a_sentence_is_broken(name, events, more):
    assert name in found(*events, **more)


def test_a_cell_that_was_born_is_one_of_the_dish():
    later = {**truth_at(2.0), "born": [[1.5, 1.5, 0.0]]}
    poses = truth_of(later).poses
    assert poses.shape == (2, 5, 3)
    assert np.isnan(poses[0, 4]).all()
    assert poses[1, 4, 0] == 1.5


def test_pictures_that_were_late_make_the_bound_later():
    late = {"kind": "pictures late", "strength": 0.5, "fault": "late_pictures", "by": 0.2, "at": 1}
    assert not found(SEEN, STOP, command(2.1, unseen=450.0), fault=late)


def test_a_frame_whose_number_comes_twice_is_that_of_its_time():
    events = [{**truth_at(t), "frame": n} for t, n in ((1.5, 7), (1.6, 8), (1.7, 7), (1.8, 8))]
    truth = truth_of(*events)
    fields = dict.fromkeys(TrialLog.__dataclass_fields__)
    times = np.array([1_500_000_000, 1_600_000_000, 1_700_000_000])
    vars(truth)["log"] = TrialLog(**fields | {"frames": np.array([7, 8, 7]), "mocap_ns": times})
    assert truth.exposure_of_frame == [1, 2, 3]  # the first exposure of all has no number


def logged(seconds, seen, meets=False):
    """What is found of a log in which robot 0 was seen at `seen` [um] for so long."""
    times = np.arange(1.0, 1.0 + seconds, 0.1)
    near = [[1.0, 1.0, 0.0], [1.03, 1.0, 0.0], *STARTS[2:]] if meets else STARTS
    events = [truth_at(times[1], 0.0, near), *(truth_at(t, 0.0) for t in times[2:])]
    poses = np.array([[STARTS[0], STARTS[1], STARTS[2]]] * len(times)) * 1000
    poses[1:, 0, :2] = seen
    truth = truth_of(SEEN, *events)
    setup = EXPERIMENT.setup
    errors = np.hypot(*(poses[-1, :, :2] - setup.targets.reshape(-1, 2)).T)
    fields = dict.fromkeys(TrialLog.__dataclass_fields__) | {
        "start": SimpleNamespace(setup=setup),
        "mocap_ns": np.round(times * 1e9).astype(int),
        "mocap": poses,
        "valid": np.ones(poses.shape[:2], bool),
        "stop": SimpleNamespace(sent_ns=round(times[-1] * 1e9)),
        "result": SimpleNamespace(outcome=Outcome.ARRIVED, robot_errors=errors, lost=(), reason=""),
    }
    vars(truth)["log"] = TrialLog(**fields)
    return truth


@pytest.mark.parametrize(
    ("specks", "began", "more", "moved"),
    [(3, 5.0, (), True), (4, 5.0, (), False), (9, 0.5, (), True), (9, 5.0, (DARK,), True)],
)
def test_a_knock_is_of_a_class_only_where_nothing_that_stands_shows_it(specks, began, more, moved):
    knock = {"kind": "knocked", "strength": 0.5, "fault": "knocked", "by_um": [30.0, 0.0], "at": 0}
    starts = [at(began, "fault", phase="start", name="", row=i) for i in range(1 + len(more))]
    plan = DayPlan(1, {"camera": {"specks": specks}}, [knock, *more], "", [*microscope_rows()])
    events = [at(0.1, "client"), *RUN, *starts]
    truth = DishTruth(Day(plan, events, 1, "", None, "", 1.0), EXPERIMENT.setup, LIMITS, 0.25)
    assert truth.moved is moved


@pytest.mark.parametrize(
    ("seconds", "seen", "meets", "expected"),
    [
        (6.0, (1010.0, 1000.0), False, set()),
        (3.0, (1990.0, 1000.0), False, {("untrue", "")}),
        (6.0, (1000.0, 1100.0), False, {("untrue", "")}),
        (6.0, (1990.0, 1000.0), True, {("untrue", "met")}),
    ],
)
def test_a_wrong_pose_is_found_unless_its_cell_has_met_the_other(seconds, seen, meets, expected):
    truth = logged(seconds, seen, meets)
    broken = [*_identity(truth, EXPERIMENT.lab.limits), *_result(truth)]
    assert {(one.name, one.predicted.partition(":")[0]) for one in broken} == expected
