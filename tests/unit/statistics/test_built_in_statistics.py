"""Tests of what each built-in statistic says of a batch, and of when it says nothing."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit import random_trials
from testkit.batches import DISTURBED, batch, experiment, result
from testkit.trials import THREE_M3PI

from tetractl.core.clock import SECOND
from tetractl.core.motion_estimate import LAG_ERROR_S
from tetractl.core.plan import Outcome
from tetractl.core.poses import Poses
from tetractl.core.trial import Verdict
from tetractl.statistics import built_in_statistics as built_in
from tetractl.statistics.built_in_statistics import SETTLING_S, discs

ERRORS = [[1.0], [2.0], [3.0], [4.0]]


def ended(*outcomes, reasons=(), **fields):
    """Trials of one robot that ended in these ways, the aborted ones for these reasons."""
    trials = batch([[1.0]] * len(outcomes), **fields)
    reasons = iter(reasons)
    return [
        replace(
            trial,
            result=result(
                [1.0], outcome=way, reason=next(reasons, "") if way is Outcome.ABORTED else ""
            ),
        )
        for trial, way in zip(trials, outcomes, strict=True)
    ]


def with_results(trials, **columns):
    """The trials with some fields of their results replaced, one value a trial."""
    rows = zip(*columns.values(), strict=True)
    return [
        replace(trial, result=replace(trial.result, **dict(zip(columns, row, strict=True))))
        for trial, row in zip(trials, rows, strict=True)
    ]


def only(figures):
    (figure,) = figures
    return figure


# ---- How trials ended ----


def test_outcomes_are_counted_and_the_most_frequent_comes_first():
    trials = ended(Outcome.ARRIVED, Outcome.TIME_LIMIT, Outcome.TIME_LIMIT, Outcome.INTERRUPTED)
    figure = only(built_in.OUTCOMES.of_batch(trials))
    assert figure.brief == "2 time limit, 1 arrived, 1 interrupted"
    assert figure.text.startswith("2 time limit (the trial's time was over); 1 arrived (")
    assert figure.items["outcomes"] == {
        way.value: [t.outcome for t in trials].count(way) for way in Outcome
    }
    assert (figure.items["aborted"], figure.items["interrupted"]) == (0, 1)


@pytest.mark.parametrize(
    ("reasons", "text"),
    [
        (["lost"], "1 aborted (lost)"),
        (["lost"] * 3, "3 aborted (lost)"),
        (["lost", "off", "lost"], "3 aborted (2 x lost; 1 x off)"),
        (["a", "b", "c"], "3 aborted (1 x a; 1 x b; 1 x c)"),
        (["a", "b", "b", "c", "d", "e"], "6 aborted (2 x b; 1 x a; 1 x c; 2 x other reasons)"),
        ([""], "1 aborted (a fault or an error ended the trial)"),
    ],
)
def test_reasons_of_aborts_are_counted_up_to_three_of_them(reasons, text):
    trials = ended(*[Outcome.ABORTED] * len(reasons), reasons=reasons)
    assert only(built_in.OUTCOMES.of_batch(trials)).text == text


def test_arrivals_are_a_fraction_of_all_trials_if_the_spec_says_what_arriving_is():
    spec = experiment(1, controller={"arrival_tolerance": 20})
    trials = ended(Outcome.ARRIVED, Outcome.TIME_LIMIT, Outcome.ARRIVED, spec=spec)
    figure = only(built_in.ARRIVED.of_batch(trials))
    assert figure.items["arrived"] == 2
    assert figure.text.startswith("2 of 3 ")
    assert not figure.unusual
    spec = experiment(1, controller={"arrival_tolerance": 0})
    figure = only(built_in.ARRIVED.of_batch(ended(Outcome.ARRIVED, spec=spec)))
    assert figure.items == {"arrived": None, "arrived_ci95": None}
    assert figure.text == "- (no arrival_tolerance)"
    assert not figure.unusual


def test_a_total_is_unusual_only_if_something_happened_and_matters():
    happened = built_in.total("x", "x", lambda trial: trial.trial)
    assert only(happened.of_batch(batch(ERRORS))).items == {"x": 0 + 1 + 2 + 3}
    assert only(happened.of_batch(batch(ERRORS))).unusual
    assert not only(happened.of_batch(batch(ERRORS[:1]))).unusual
    immaterial = built_in.total("x", "x", lambda trial: trial.trial, lambda trial: False)
    assert not only(immaterial.of_batch(batch(ERRORS))).unusual
    assert happened.of_trial(batch(ERRORS)[2]) == {"x": 2}


def test_missed_deadlines_matter_only_where_time_is_real():
    late = with_results(batch(ERRORS), deadline_misses=(0, 2, 0, 1))
    figure = only(built_in.DEADLINE_MISSES.of_batch(late))
    assert figure.items == {"deadline_misses": 3}
    assert not figure.unusual


# ---- Distances ----

DISTANCES = st.lists(st.lists(st.floats(-50, 500), max_size=3), min_size=1, max_size=6)


@given(DISTANCES)
def test_a_minimum_is_over_all_robots_and_trials_that_have_it(rows):
    nearest = built_in.minimum("near", "nearest", lambda verdict: verdict.edge)
    trials = [
        replace(
            trial, result=replace(trial.result, verdict=replace(trial.result.verdict, edge=row))
        )
        for trial, row in zip(batch([[1.0]] * len(rows)), map(tuple, rows), strict=True)
    ]
    figure = only(nearest.of_batch(trials))
    known = [value for row in rows for value in row]
    assert figure.items == {"near": min(known) if known else None}
    assert (figure.text == "-") == (not known)
    assert figure.label == "nearest [mm]"
    assert not figure.unusual
    for trial, row in zip(trials, rows, strict=True):
        assert nearest.of_trial(trial) == {"near": min(row) if row else None}


def test_a_robot_alone_is_near_to_nothing():
    alone = built_in.minimum("near", "nearest", lambda verdict: verdict.apart)
    (trial,) = batch([[1.0]])
    verdict = replace(trial.result.verdict, apart=(float("inf"),))
    trial = replace(trial, result=replace(trial.result, verdict=verdict))
    assert alone.of_trial(trial) == {"near": None}
    assert only(alone.of_batch([trial])).items == {"near": None}


# ---- What must not happen ----


def near(edge, clearance, radius=None):
    """A trial of one robot, by its least distances to the edge and to an obstacle."""
    control = {"type": "mpc", "collision": {"radius": radius}} if radius else {}
    (trial,) = batch([[1.0]], experiment(1, controller=control))
    final = Poses.from_array(np.zeros((1, 3)))
    verdict = Verdict(final, (clearance < 0,), (clearance,), edge=(edge,), apart=(float("inf"),))
    return replace(trial, result=replace(trial.result, verdict=verdict))


def labels_shown(statistic, trials, unusual):
    return [f.label for f in statistic.of_batch(trials) if f.label and f.unusual == unusual]


def test_leaving_the_arena_is_told_only_if_it_happened_and_obstacles_are_always_told():
    inside, outside = near(20.0, 20.0), near(-1.0, -1.0)
    assert labels_shown(built_in.LEFT_ARENA, [inside], True) == []
    assert labels_shown(built_in.LEFT_ARENA, [inside, outside], True) == ["left the arena"]
    for trials in ([inside], [outside]):
        entered = labels_shown(built_in.OBSTACLE_VIOLATIONS, trials, True)
        assert entered == ["entered an obstacle"]
    assert labels_shown(built_in.TOUCHED, [inside], True) == []


def test_of_bodies_and_centres_only_one_line_has_a_label():
    bodies, centres = built_in.LEFT_ARENA.of_batch([near(5.0, 5.0, radius=10)])
    assert (bodies.label, centres.label) == ("left the arena", "")
    assert bodies.unusual  # its body did, although its centre did not
    assert (bodies.items["body_over_edge"], centres.items["left_arena"]) == (1, 0)
    bodies, centres = built_in.LEFT_ARENA.of_batch([near(5.0, 5.0)])
    assert (bodies.label, centres.label) == ("", "left the arena")
    assert bodies.items == {"body_over_edge": None, "body_over_edge_ci95": None}


def test_a_body_touches_what_is_nearer_than_its_radius_and_not_what_is_at_it():
    columns = [built_in.LEFT_ARENA.of_trial(near(edge, 50.0, radius=10)) for edge in (9.9, 10.0)]
    assert [column["body_over_edge"] for column in columns] == [True, False]
    assert [column["outside_arena"] for column in columns] == [False, False]
    assert built_in.LEFT_ARENA.of_trial(near(5.0, 5.0))["body_over_edge"] is None


# ---- Means of the numbers of a trial ----


def via_trials(*passed):
    """Trials of a robot with two way-points, of which each trial passed some."""
    robot = THREE_M3PI["robots"][0] | {"via": [[1000, 700], [1300, 600]]}
    spec = experiment(robots=1, plant=DISTURBED)
    spec = spec.model_validate(spec.model_dump(mode="json") | {"robots": [robot]})
    return with_results(batch([[1.0]] * len(passed), spec), passed=passed)


def test_way_points_that_were_not_passed_are_left_out_of_the_mean_of_their_own():
    trials = via_trials((10.0, 30.0), (20.0,), ())
    assert [built_in.WAY_POINTS.of_trial(trial) for trial in trials] == [
        {"way_point_1": 10.0, "way_point_2": 30.0},
        {"way_point_1": 20.0, "way_point_2": None},
        {"way_point_1": None, "way_point_2": None},
    ]
    first, second = built_in.WAY_POINTS.of_batch(trials)
    assert (first.items, second.items) == ({"way_point_1": 15.0}, {"way_point_2": 30.0})
    assert first.text == "15.0 (n 2)"
    assert second.text == "30.0 (n 1)"


def test_a_way_point_that_no_trial_passed_has_no_mean():
    *_, second = built_in.WAY_POINTS.of_batch(via_trials((10.0,), ()))
    assert second.items == {"way_point_2": None}
    assert second.text == "-"


def test_robots_without_way_points_or_a_hold_have_no_such_figures():
    trials = batch(ERRORS)
    for statistic in (built_in.WAY_POINTS, built_in.TIME_INSIDE, built_in.LOST):
        assert statistic.of_trial(trials[0]) == {}
        assert list(statistic.of_batch(trials)) == []


def holding(seconds=8):
    return experiment(1, hold={"time": seconds, "radius": 30})


def test_the_time_within_the_radius_is_known_only_of_trials_that_ran_to_their_end():
    trials = ended(Outcome.TIME_LIMIT, Outcome.TIME_LIMIT, Outcome.ABORTED, spec=holding())
    trials = with_results(trials, inside=((0.5,), (1.0,), (0.1,)))
    columns = [built_in.TIME_INSIDE.of_trial(trial) for trial in trials]
    assert columns == [{"inside_green": share} for share in (0.5, 1.0, None)]
    figure = only(built_in.TIME_INSIDE.of_batch(trials))
    assert figure.items == {"inside_green": 0.75}
    assert figure.text == "0.750 (n 2)"


# ---- How tightly robots were held ----


@pytest.fixture(scope="module")
def made_up(tmp_path_factory):
    """The log of 50 made-up control steps of three robots."""
    steps = random_trials.trial(steps=50, frames=1, first=1, iterations=1, length=2)
    return random_trials.write_and_read(steps, tmp_path_factory.mktemp("log") / "trial.mcap")


def held_log(log, since_s, truth=True):
    """A log of 10 s whose robots hold from a time on, at known distances from their targets.

    Robot i is 10 (i + 1) mm from its target in each frame, and in every tenth frame 1000 mm.
    """
    frames = 1000
    times_ns = np.arange(frames) * (SECOND // 100)
    setup = log.start.setup
    away = np.where(np.arange(frames)[:, None] % 10 == 0, 1000.0, 10.0 * np.arange(1, 4))
    poses = np.zeros((frames, 3, 3))
    poses[..., :2] = setup.targets
    poses[..., 0] += away
    steps = []
    for k, step in enumerate(log.steps):
        sampled_ns = k * SECOND // 5
        seen = replace(step.observation, sampled_ns=sampled_ns)
        leg = len(setup.legs) if sampled_ns >= since_s * SECOND else len(setup.legs) - 1
        steps.append(replace(step, observation=seen, plan=replace(step.plan, leg=leg)))
    return replace(
        log,
        steps=tuple(steps),
        mocap=poses if not truth else poses + 500,
        mocap_ns=times_ns,
        truth=poses if truth else None,
        valid=np.ones((frames, 3), bool),
        frames=np.arange(frames),
    )


def test_a_disc_has_twice_the_distance_within_which_a_robot_is_for_95_percent_of_the_time(made_up):
    """A tenth of the frames is far away, so that more than 5 % are."""
    assert discs(held_log(made_up, 1.0)) == pytest.approx([2000.0] * 3)


@pytest.mark.parametrize("truth", [True, False])
def test_only_frames_after_the_first_5_s_of_a_hold_count(made_up, truth):
    since_s = 2.0
    log = held_log(made_up, since_s, truth)
    path = log.truth if truth else log.mocap
    counted = log.mocap_ns >= (since_s + SETTLING_S) * SECOND
    path[~counted, :, 0] += 5000
    far = np.arange(len(path)) % 10 == 0
    path[far & counted, :, :2] = log.start.setup.targets  # near in the frames that count
    assert discs(log) == pytest.approx([20.0, 40.0, 60.0])


@pytest.mark.parametrize("since_s", [5.01, 99.0])
def test_a_hold_that_was_too_short_has_no_disc(made_up, since_s):
    """Steps are every 0.2 s: the hold begins at 5.2 s, and 10 s have passed before it counts."""
    assert np.isnan(discs(held_log(made_up, since_s))).all()


def test_frames_without_a_pose_are_left_out_of_a_disc(made_up):
    log = held_log(made_up, 1.0, truth=False)
    log.mocap[::2, 1] = np.nan  # every other frame, and with them all the far ones
    assert discs(log) == pytest.approx([2000.0, 40.0, 2000.0])


def test_discs_are_of_trials_with_a_hold_longer_than_its_settling(monkeypatch):
    read = []
    monkeypatch.setattr(built_in, "_cached_discs", lambda log, digest: read.append(log) or (30.0,))
    trials = ended(Outcome.TIME_LIMIT, Outcome.ABORTED, Outcome.TIME_LIMIT, spec=holding())
    columns = [built_in.DISC.of_trial(trial) for trial in trials]
    assert columns == [{"disc_green": diameter} for diameter in (30.0, None, 30.0)]
    assert [log.name for log in read] == ["trial-000.mcap", "trial-002.mcap"]
    figure = only(built_in.DISC.of_batch(trials))
    assert figure.items["disc_green"]["mean"] == 30.0
    assert figure.items["disc_green"]["n"] == 2
    for spec in (holding(SETTLING_S), experiment(1)):
        trials = ended(Outcome.TIME_LIMIT, spec=spec)
        assert built_in.DISC.of_trial(trials[0]) == {}
        assert list(built_in.DISC.of_batch(trials)) == []


# ---- The lag of the wheels ----


@pytest.mark.parametrize(
    ("offset_s", "unusual"),
    [(1.05 * LAG_ERROR_S, True), (-1.05 * LAG_ERROR_S, True), (0.95 * LAG_ERROR_S, False)],
)
def test_a_lag_is_unusual_if_it_is_far_from_the_one_in_the_spec(offset_s, unusual):
    spec = experiment(1, wheels={"radius": 40, "lag": 0.2})
    stated_s = spec.setup.lag_s
    assert stated_s == 0.2
    found = stated_s + offset_s
    trials = with_results(batch(ERRORS, spec), wheel_lag_s=(found, None, found, None))
    figure = only(built_in.WHEEL_LAG.of_batch(trials))
    assert figure.unusual == unusual
    assert figure.text == f"{found:.3f} measured (n = 2), 0.200 in the spec"
    assert built_in.WHEEL_LAG.of_trial(trials[0]) == {"wheel_lag_s": found}
    assert built_in.WHEEL_LAG.of_trial(trials[1]) == {"wheel_lag_s": None}


def test_robots_without_wheels_have_no_column_for_a_lag():
    assert built_in.WHEEL_LAG.of_trial(batch(ERRORS)[0]) == {}
