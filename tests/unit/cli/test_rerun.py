"""Tests of `rerun`: the plant of the new trial, and when two logs are compared."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from testkit.marked_robots import MarkedRobots
from testkit.paths import ROOT

from tetractl.cli import rerun as module
from tetractl.cli.rerun import _compare_logs, _print_errors, _select_plant
from tetractl.core.errors import Exit
from tetractl.core.plan import Outcome
from tetractl.log.read import reader, salvage
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant
from tetractl.verification import log_comparison, verify

LAB = load_spec(ROOT / "experiments/three_m3pi_lab.yaml")
IN_LAB = select_plant(LAB, "lab")

# `reader`, `salvage`, `log_comparison` and `verify` are imported before a test replaces their
# functions: a module that is first imported in such a test would keep what replaces them.


def test_the_trial_of_a_lab_is_simulated_unless_robots_are_to_move():
    assert _select_plant(IN_LAB, "sim").experiment.plant.type == "sim"
    again = _select_plant(IN_LAB, "lab").experiment
    assert again.plant == IN_LAB.experiment.plant
    assert _select_plant(LAB, "lab").experiment.plant.type == "lab"
    assert _select_plant(LAB, "sim").experiment.plant.type == "sim"


def test_robots_that_a_trial_chose_are_chosen_again_in_a_lab_only():
    found = MarkedRobots(marks=((1, 1),), found=True)
    chosen = replace(IN_LAB, experiment=IN_LAB.experiment.model_copy(update={"chosen": found}))
    assert _select_plant(chosen, "lab").experiment.chosen == MarkedRobots(marks=((1, 1),))
    assert _select_plant(chosen, "sim").experiment.chosen == found


def raw(digest="d1", path="a.mcap", spec="x", damaged=False):
    return SimpleNamespace(
        content_digest=digest,
        path=path,
        damaged=damaged,
        run=SimpleNamespace(unit="mm"),
        attachment_text=lambda name: spec,
    )


def plant(kind="sim", real_time=False):
    return SimpleNamespace(type=kind, real_time=real_time)


SIMULATED = (plant(), plant())


@pytest.fixture
def compared(monkeypatch, capsys):
    """Compare two logs; returns the exit code and the lines that are printed."""

    def compare(first, second, plants=SIMULATED, outcome=Outcome.ARRIVED, lines=()):
        of_trial, again = plants
        result = SimpleNamespace(experiment=SimpleNamespace(plant=again), outcome=outcome)
        monkeypatch.setattr(reader, "result_of", lambda log: result)
        monkeypatch.setattr(
            log_comparison,
            "log_differences",
            lambda one, other: iter(["step 3 differs", "step 4 differs"]),
        )
        monkeypatch.setattr(verify, "host_differences", lambda log: lines)
        trial = SimpleNamespace(experiment=SimpleNamespace(plant=of_trial))
        code = _compare_logs(first, trial, second)
        return code, capsys.readouterr().err.splitlines()

    return compare


def test_logs_of_the_same_content_agree(compared):
    assert compared(raw(), raw(path="b.mcap")) == (
        Exit.DONE, ["the content digests agree: d1"],
    )  # fmt: skip


def test_logs_of_other_content_fail_with_the_first_difference(compared):
    code, lines = compared(raw(), raw("d2", "b.mcap"))
    assert code == Exit.FAILED
    assert lines == [
        "the content digests differ: d1 in a.mcap, d2 in b.mcap",
        "  step 3 differs",
    ]


@pytest.mark.parametrize(
    ("fields", "outcome", "is_told"),
    [
        ({}, Outcome.ARRIVED, False),
        ({"damaged": True}, Outcome.ARRIVED, True),
        ({}, Outcome.ABORTED, True),
    ],
)
def test_a_log_that_is_damaged_or_cut_short_may_differ(compared, fields, outcome, is_told):
    _, lines = compared(raw(**fields), raw("d2"), outcome=outcome)
    assert ("  a.mcap is damaged, or its trial was cut short" in lines) == is_told


def test_other_reasons_for_a_difference_are_told(compared):
    _, lines = compared(raw(), raw("d2", spec="y"), lines=["other processor"])
    assert lines[2:] == [
        "  the spec in the log lacks fields that this version of tetractl has",
        "  other processor",
    ]


@pytest.mark.parametrize(
    ("plants", "says"),
    [
        ((plant("lab", True), plant()), "the log comes from the lab, but the new log "
         "comes from a simulation"),
        ((plant(), plant("emulated")), "the log comes from a simulation, but the new "
         "log comes from an emulated lab"),
        ((plant("lab", True), plant("lab", True)), "both logs come from the lab"),
        ((plant("own", True), plant("own", True)), "both logs come from own"),
    ],
)  # fmt: skip
def test_trials_that_cannot_repeat_are_not_compared(compared, plants, says):
    code, lines = compared(raw(), raw("d2"), plants)
    assert code == Exit.DONE
    assert lines == [f"{says}, so they are not compared"]


def test_of_another_spec_only_the_errors_are_told(monkeypatch, capsys):
    errors = {"a.mcap": 12.345, "b.mcap": 6.789}
    monkeypatch.setattr(
        reader,
        "result_of",
        lambda log: SimpleNamespace(result=SimpleNamespace(total_error=errors[log.path])),
    )
    _print_errors(raw(), raw(path="b.mcap"))
    said = capsys.readouterr().err
    assert said.startswith("the total error is 6.79 mm now, and was 12.35 mm in the log; nothing")


@pytest.fixture
def rerun(monkeypatch):
    """Rerun a trial of a log; returns what was run, and how the logs were compared."""
    done = SimpleNamespace(compared=None, code=Exit.DONE)

    def run(**options):
        trial = SimpleNamespace(
            spec=LAB,
            start=SimpleNamespace(resolved=LAB.resolved, trial=3),
            experiment=LAB.experiment,
        )
        monkeypatch.setattr(module, "find_log", lambda log: log)
        monkeypatch.setattr(salvage, "scan", lambda path: path)
        monkeypatch.setattr(reader, "trial_of", lambda raw: trial)

        def run_command(spec, how, only_trial):
            done.spec, done.how, done.only = spec, how, only_trial
            return done.code, ROOT

        def compare(*_):
            done.compared = "logs"
            return Exit.FAILED

        def tell(*_):
            done.compared = "errors"

        monkeypatch.setattr(module, "run_command", run_command)
        monkeypatch.setattr(module, "_compare_logs", compare)
        monkeypatch.setattr(module, "_print_errors", tell)
        return module.rerun(ROOT / "a.mcap", **options)

    done.run = run
    return done


def test_the_trial_with_the_same_number_is_run_and_its_log_compared(rerun):
    assert rerun.run() == Exit.FAILED
    assert (rerun.only, rerun.compared) == (3, "logs")
    assert rerun.spec.hash == LAB.hash


def test_with_another_value_only_errors_are_compared(rerun):
    assert rerun.run(sets=["robots.0.a=5"]) == Exit.DONE
    assert rerun.compared == "errors"
    assert rerun.spec.experiment.robots[0].a == 5


@pytest.mark.parametrize(("code", "dry"), [(Exit.FAILED, False), (Exit.DONE, True)])
def test_nothing_is_compared_after_a_failure_or_a_dry_run(rerun, code, dry):
    rerun.code = code
    assert rerun.run(dry_run=dry) == code
    assert rerun.compared is None
    assert rerun.how.dry_run is dry
