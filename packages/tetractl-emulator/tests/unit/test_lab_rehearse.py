"""Tests of `tetractl lab rehearse` with made-up days: what it prints, keeps and repeats."""

from itertools import count
from types import SimpleNamespace

import pytest
import yaml
from testkit.cli import tetractl
from testkit.emulator.lab_processes import SPEC
from testkit.emulator.made_days import at
from testkit.paths import EXAMPLES
from tetractl_emulator import lab_rehearse
from tetractl_emulator.lab_rehearse import WATCHDOG_S, observe_day, rehearse_day
from tetractl_emulator.rehearsal.day import DayOutcome
from tetractl_emulator.rehearsal.day_plan import DayPlan

from tetractl.core.plan import Outcome
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant

pytestmark = pytest.mark.slow

OUTSIDE = ["outside", 1.25, "green: 30 mm beyond what is allowed"]


class MadeDays:
    """Stands for the days of a rehearsal: which were run, and what each violates."""

    def __init__(self):
        self.played = []
        self.violations = {}
        self.interrupted_on = None

    def rehearse_day(self, spec, sets, seed, day, with_faults=True, folder=None):
        if day == self.interrupted_on:
            raise KeyboardInterrupt
        self.played.append((day, seed, with_faults))
        return {
            "day": day,
            "digest": f"d{day}",
            "seconds": 1.5,
            "ended": "aborted" if day % 2 else "arrived",
            "reason": "green is lost" if day % 2 else "",
            "met": [["pushed", 0.25]] if day % 2 else [],
            "violations": self.violations.get(day, []),
        }


@pytest.fixture
def days(monkeypatch):
    made = MadeDays()
    tried = SimpleNamespace(outcome=Outcome.TIME_LIMIT, reason="")
    monkeypatch.setattr(lab_rehearse, "rehearse_day", made.rehearse_day)
    monkeypatch.setattr(lab_rehearse.gc, "freeze", lambda: None)
    monkeypatch.setattr("tetractl.control.methods.build.warm_up", lambda *_: None)
    monkeypatch.setattr("tetractl.run.logged_trial.run_logged", lambda spec, folder: tried)
    made.tried = tried
    return made


def rehearse(folder, *words):
    return tetractl(folder, "lab", "rehearse", SPEC, *words)


def numbers(days):
    return [day for day, *_ in days.played]


def test_days_are_run_and_summarised(tmp_path, days):
    done = rehearse(tmp_path, "--days", "3").ok()
    assert days.played == [(0, 1, True), (1, 1, True), (2, 1, True)]
    table, reasons, summary, last = done.stdout.strip().split("\n\n")
    assert "| pushed | 1 | 1 | 1 | 0.250 | 0.250 | 0.250 |" in table
    assert reasons == "1 day: green is lost"
    assert summary == "2 arrived (67%); 1 aborted (33%); 1.50 s of processor time a day"
    assert last == "3 days, 0 violations"
    assert (tmp_path / "rehearsal-1").is_dir()


def test_each_day_is_told_with_how_long_the_others_take(tmp_path, days, monkeypatch):
    seconds = count(step=200.0)
    monkeypatch.setattr(lab_rehearse, "time", SimpleNamespace(monotonic=lambda: next(seconds)))
    lines = rehearse(tmp_path, "--days", "3").ok().stderr.splitlines()
    assert lines == [
        "1 of 3, about 7 min more: day 0: arrived",
        "2 of 3, about 3 min more: day 1: aborted",
        "3 of 3: day 2: arrived",
    ]


@pytest.mark.parametrize(("step_s", "remaining"), [(89.0, "89 s"), (90.0, "2 min")])
def test_the_rest_is_told_in_minutes_if_it_is_longer_than_one_and_a_half(
    tmp_path, days, monkeypatch, step_s, remaining
):
    seconds = count(step=step_s)
    monkeypatch.setattr(lab_rehearse, "time", SimpleNamespace(monotonic=lambda: next(seconds)))
    lines = rehearse(tmp_path, "--days", "2").ok().stderr.splitlines()
    assert lines[0] == f"1 of 2, about {remaining} more: day 0: arrived"


def test_days_that_a_folder_has_are_not_run_again_but_counted(tmp_path, days):
    rehearse(tmp_path, "--days", "2", "--out", "days").ok()
    done = rehearse(tmp_path, "--days", "3", "--out", "days").ok()
    assert numbers(days) == [0, 1, 2]
    assert done.stderr.splitlines() == ["1 of 1: day 2: arrived"]
    assert done.stdout.endswith("3 days, 0 violations\n")
    fewer = rehearse(tmp_path, "--days", "1", "--out", "days").ok()
    assert numbers(days) == [0, 1, 2]
    assert fewer.stdout.endswith("1 day, 0 violations\n")


def test_the_first_day_and_the_seed_are_those_that_are_given(tmp_path, days):
    rehearse(tmp_path, "--first", "7", "--days", "2", "--seed", "31", "--no-faults").ok()
    assert days.played == [(7, 31, False), (8, 31, False)]
    assert (tmp_path / "rehearsal-31").is_dir()


@pytest.mark.parametrize(
    "other", [("--seed", "2"), ("--no-faults",), ("--set", "controller.time_limit=9")]
)
def test_days_of_another_rehearsal_are_not_continued(tmp_path, days, other):
    rehearse(tmp_path, "--days", "1", "--out", "days").ok()
    done = rehearse(tmp_path, "--days", "2", "--out", "days", *other)
    assert done.returncode == 2
    assert numbers(days) == [0]


def test_a_violation_is_told_and_fails_the_rehearsal_now_and_again(tmp_path, days):
    days.violations = {1: [OUTSIDE, ["log", 0.0, "the log lacks a command that was sent"]]}
    for _ in range(2):
        done = rehearse(tmp_path, "--days", "3", "--out", "days")
        assert done.returncode == 1
        assert done.stdout.endswith("3 days, 1 violation\n")
    first = rehearse(tmp_path, "--days", "3", "--out", "new")
    assert "day 1, 1.25 s: outside: green: 30 mm beyond what is allowed" in first.stderr
    assert "day 1, 0.00 s: log: the log lacks a command that was sent" in first.stderr
    others = rehearse(tmp_path, "--days", "1", "--out", "new").ok()
    assert others.stdout.endswith("1 day, 0 violations\n")


def test_a_rehearsal_that_is_interrupted_says_how_to_go_on_and_counts_what_is_done(tmp_path, days):
    days.interrupted_on = 2
    done = rehearse(tmp_path, "--days", "5", "--out", "days")
    assert done.returncode == 130
    assert "interrupted; to continue, run the same command again with --out days" in done.stderr
    assert done.stdout.endswith("2 days, 0 violations\n")
    days.violations = {2: [OUTSIDE]}
    days.interrupted_on = 3
    assert rehearse(tmp_path, "--days", "5", "--out", "days").returncode == 1


def test_a_lab_in_which_a_trial_without_faults_is_aborted_is_not_rehearsed(tmp_path, days):
    days.tried.outcome = Outcome.ABORTED
    days.tried.reason = "no camera frame"
    done = rehearse(tmp_path, "--days", "2")
    assert done.returncode == 1
    assert "error: a trial without any faults was aborted: no camera frame" in done.stderr
    assert "hint: the spec itself causes this abort" in done.stderr
    assert days.played == []
    assert list(tmp_path.iterdir()) == []


def test_the_trial_before_the_days_is_short(tmp_path, days, monkeypatch):
    tried = []
    monkeypatch.setattr(
        "tetractl.run.logged_trial.run_logged",
        lambda spec, folder: tried.append(spec.experiment) or days.tried,
    )
    rehearse(tmp_path, "--days", "1").ok()
    (experiment,) = tried
    assert experiment.controller.time_limit == 1
    assert experiment.plant.type == "emulated"


@pytest.mark.parametrize("words", [("--days", "0"), ("--seed", "-1"), ("--first", "-1")])
def test_no_rehearsal_has_less_than_one_day_or_a_negative_number(tmp_path, days, words):
    assert rehearse(tmp_path, *words).returncode == 2
    assert days.played == []


# One day


class MadeDay:
    """Stands for the run of a day, which leaves these events and this exit code."""

    def __init__(self, monkeypatch, exit_code=0, output=""):
        self.plan = DayPlan(77, {}, [], ("controller.time_limit=4",))
        self.planned = []
        self.ran = []
        self.outcome = DayOutcome(self.plan, [at(0.0, "ready")], exit_code, output, None, "", 2.0)
        at_run = "tetractl_emulator.rehearsal.day.run_day"
        monkeypatch.setattr(at_run, lambda *run: self.ran.append(run) or self.outcome)
        at_plan = "tetractl_emulator.rehearsal.day_plan.plan_of_day"
        monkeypatch.setattr(at_plan, lambda *drawn: self.planned.append(drawn) or self.plan)


REFUSED = "error: no camera server answers\n"


def test_a_day_is_planned_from_its_seed_and_run_with_what_the_plan_sets(monkeypatch, tmp_path):
    day = MadeDay(monkeypatch, 1, REFUSED)
    row = rehearse_day(SPEC, ("trials.seed=3",), 5, 9, False)
    ((seed, number, lab, setup, chosen, bad),) = day.planned
    assert (seed, number, chosen, bad) == (5, 9, False, False)
    assert len(setup.names) == 3
    assert lab.type == "emulated"
    ((spec, sets, plan, _),) = day.ran
    assert (spec, plan) == (SPEC, day.plan)
    assert sets == ("trials.seed=3", "controller.deadline=60", "controller.time_limit=4")
    assert row["day"] == 9
    assert row["ended"] == "refused"
    assert row["seconds"] >= 2.0


def test_a_controller_without_a_deadline_is_given_none(monkeypatch):
    day = MadeDay(monkeypatch, 1, REFUSED)
    rehearse_day(SPEC, ("controller={type: sequence, period: 0.2, directions: [0.0]}",), 1, 0)
    assert not any("deadline" in setting for setting in day.ran[0][1])


def test_only_a_day_that_violates_an_invariant_leaves_a_script(monkeypatch, tmp_path):
    MadeDay(monkeypatch, 0)  # it ends as if all were well, without a run
    row = rehearse_day(SPEC, (), 5, 9, folder=tmp_path)
    assert row["violations"]
    (script,) = tmp_path.iterdir()
    assert script.name == "seed-5-day-9.yaml"
    about = yaml.safe_load(script.read_text())["about"]
    assert about == f"seed 5, day 9: {row['violations'][0][0]}; the trial's seed is 77"
    assert "time_limit=4" in script.read_text()
    rehearse_day(SPEC, (), 5, 10)  # without a folder
    MadeDay(monkeypatch, 1, "")
    quiet = rehearse_day(SPEC, (), 5, 11, folder=tmp_path)
    assert not quiet["violations"]
    assert [file.name for file in tmp_path.iterdir()] == ["seed-5-day-9.yaml"]


@pytest.mark.parametrize(
    ("watchdog", "watchdog_s"), [("wheels.watchdog=0.4", 0.4), (None, WATCHDOG_S)]
)
def test_a_robot_stops_after_the_watchdog_of_the_spec(watchdog, watchdog_s):
    sets = (watchdog,) if watchdog else ()
    experiment = select_plant(load_spec(SPEC, sets), "emulated").experiment
    if watchdog is None and experiment.wheels is not None:
        watchdog_s = experiment.wheels.watchdog or WATCHDOG_S
    day = DayOutcome(DayPlan(1, {}, []), [], 1, REFUSED, None, "", 1.0)
    truth, _ = observe_day(day, experiment, experiment.plant)
    assert truth.watchdog_s == watchdog_s
    assert truth.can_stand_still


def test_cells_are_observed_by_the_invariants_that_hold_for_cells():
    pytest.importorskip("cv2")
    dish = select_plant(load_spec(EXAMPLES / "tetrahymena_dish.yaml"), "emulated").experiment
    moving = [at(1.0 + k / 60, "truth", poses=[], unseen_ms=[], frame=1) for k in range(3)]
    day = DayOutcome(DayPlan(1, {}, []), moving, 1, "", None, "", 1.0)
    truth, violations = observe_day(day, dish, dish.plant)
    assert not truth.can_stand_still
    assert violations == []
