"""Tests of the game of `play`: which trials it has, what it says of them, and how it ends."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from testkit.batches import result

from tetractl.cli import play
from tetractl.cli.play import (
    Game,
    _conclude,
    _describe_error,
    _describe_result,
    _find_best,
    _play_on_terminal,
    _suggest_disturbances,
    _summarise_game,
)
from tetractl.core.errors import Exit
from tetractl.core.plan import Outcome
from tetractl.run.hand import HandController
from tetractl.run.interrupt import Interrupt
from tetractl.spec.load import parse_spec
from tetractl.view.terminal.hand_keys import CONTINUE_KEY, REPEAT_KEY

SPEC = parse_spec(
    """
name: by-hand
arena: {left: 0, bottom: 0, width: 1000, height: 1000}
robots: [{name: a, start: [300, 500], target: [400, 500], a: 3, speed: 100}]
""",
    "s.yaml",
)


def ended(errors=(30.0,), outcome=Outcome.ARRIVED, reason="", entered=False, outside=False):
    """The result of a trial of one robot that took 12.4 s."""
    made = result(list(errors))
    verdict = replace(
        made.verdict,
        entered=(entered,),
        clearance=(5.0,),
        edge=(-1.0 if outside else 9.0,),
    )
    return replace(made, outcome=outcome, reason=reason, verdict=verdict, duration_s=12.4)


STOPPED = ended(outcome=Outcome.ABORTED, reason="a robot left the arena")


@pytest.fixture
def game(tmp_path):
    folder = tmp_path / "game"
    folder.mkdir()
    return Game(SPEC, SPEC, folder, Interrupt())


# what is said of a trial


def test_a_trial_is_described_by_its_error_and_time_and_by_what_went_wrong():
    experiment = SPEC.experiment
    assert _describe_result(ended(), experiment) == "30.0 mm in 12 s"
    assert (
        _describe_result(ended(entered=True), experiment) == "30.0 mm in 12 s through an obstacle"
    )
    assert _describe_result(ended(outside=True), experiment) == "30.0 mm in 12 s outside the arena"
    both = _describe_result(ended(entered=True, outside=True), experiment)
    assert both == "30.0 mm in 12 s through an obstacle and outside the arena"
    assert _describe_result(STOPPED, experiment) == "stopped after 12.4 s (a robot left the arena)"


@pytest.mark.parametrize(
    ("width", "error", "text"),
    [
        (1000, 0.0, "< 0.01 mm"),
        (1000, 0.0099, "< 0.01 mm"),
        (9999, 0.0099, "< 0.01 mm"),
        (10, 0.0, "< 0.0001 mm"),
    ],
)
def test_an_error_too_small_for_the_arena_is_a_limit(width, error, text):
    spec = SPEC.experiment
    robots = (spec.robots[0].model_copy(update={"start": (1, 1), "target": (2, 2)}),)
    arena = spec.arena.model_copy(update={"width": width})
    experiment = spec.model_copy(update={"arena": arena, "robots": robots})
    assert _describe_error(ended([error]), experiment) == f"{text} in 12 s"
    assert "<" not in _describe_error(ended([0.02]), experiment)


def test_the_best_try_is_the_nearest_one_that_was_not_lost():
    near = ended([1.0], outside=True)
    through = ended([2.0], entered=True)
    aborted = replace(STOPPED, total_error=3.0)
    good = ended([20.0])
    assert _find_best([near, ended([40.0]), good, through, aborted]) is good
    assert _find_best([through, near, aborted]) is near  # if all are lost, the nearest of all


def test_one_line_tells_all_tries_and_the_controller(game):
    game.own_results = [ended([30.0])]
    assert _summarise_game(game) == "you 30.0 mm in 12 s"
    game.own_results = [ended([30.0]), ended([20.0]), ended([10.0])]
    game.controller_result = ended([5.0])
    assert _summarise_game(game) == (
        "you 30.0 mm in 12 s, again 20.0 mm in 12 s, again 10.0 mm in 12 s, "
        "the controller 5.00 mm in 12 s"
    )


def test_a_spec_with_disturbances_is_suggested_only_if_this_one_simulates_none(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    lines = _suggest_disturbances(SPEC.experiment)
    assert [line.split()[:2] for line in lines[1:]] == [["tetractl", "init"], ["tetractl", "play"]]
    file = tmp_path / lines[-1].split()[-1]
    file.parent.mkdir()
    file.touch()
    assert len(_suggest_disturbances(SPEC.experiment)) == 2  # it need not be written first
    disturbed = parse_spec(SPEC.text, "s", ["plant.a_error=0.1"])
    assert _suggest_disturbances(disturbed.experiment) == []
    lab = SimpleNamespace(plant=SimpleNamespace(disturbed=False, simulated=False))
    assert _suggest_disturbances(lab) == []


# the trials of a game


@pytest.fixture
def trials(monkeypatch):
    """Let trials end with these results; each is a pair of result and whether a key was given."""
    results = []
    folders = []

    def run(directed, folder, hand, observers, interrupt, supervision):
        ends, is_steered = results.pop(0)
        hand.directions.extend([0.0] * is_steered)
        folders.append(folder.name)
        return ends

    monkeypatch.setattr("tetractl.run.hand.run_by_hand", run)
    monkeypatch.setattr(
        "tetractl.run.hand.HandController",
        lambda *_: SimpleNamespace(directions=[], spec=HandController),
    )
    return SimpleNamespace(results=results, folders=folders)


def test_each_try_has_a_folder_of_its_own(game, trials):
    trials.results += [(ended(), True), (STOPPED, True), (ended(), True)]
    for _ in range(3):
        game.steer(lambda *_: None)
    assert trials.folders == ["you", "you-2", "you-3"]
    assert [folder.name for folder in game.folders] == trials.folders
    game.controller_result = ended()
    assert [folder.name for folder in game.folders] == [*trials.folders, "controller"]
    assert not game.over
    assert game.error == ""


def test_a_try_without_a_direction_ends_the_game_and_does_not_count(game, trials):
    trials.results.append((ended(), False))
    game.steer(lambda *_: None)
    assert game.over
    assert game.own_results == []
    assert game.error == ""


def supervised(game, pressed):
    emergency = SimpleNamespace(is_set=lambda: pressed)
    return SimpleNamespace(emergency=emergency)


@pytest.mark.parametrize(("pressed", "is_error"), [(False, False), (True, True)])
def test_a_stopped_try_is_an_error_only_after_an_emergency_stop(game, trials, pressed, is_error):
    trials.results.append((STOPPED, True))
    game.steer(lambda *_: None, supervision=supervised(game, pressed))
    assert game.over is is_error
    assert game.error == ("a robot left the arena" if is_error else "")


@pytest.mark.parametrize("outcome", [STOPPED, ended()])
def test_an_abort_of_real_robots_ends_the_game(game, trials, outcome):
    plant = SimpleNamespace(real_time=True)
    game.experiment = SimpleNamespace(plant=plant)
    trials.results.append((outcome, True))
    game.steer(lambda *_: None, supervision=supervised(game, False))
    assert game.over is (outcome is STOPPED)
    assert bool(game.error) is (outcome is STOPPED)


def interrupted(game):
    game.interrupt.request()
    return game


def test_a_game_is_over_once_it_was_interrupted(game, trials):
    trials.results.append((ended(), True))
    interrupted(game).steer(lambda *_: None)
    assert game.over
    assert game.error == ""


def test_the_controller_runs_in_its_folder_and_cannot_lose_the_game(game, monkeypatch):
    asked = []

    def run_logged(spec, folder, trial, observers, interrupt):
        asked.append((folder, folder.is_dir()))
        return STOPPED

    monkeypatch.setattr("tetractl.run.logged_trial.run_logged", run_logged)
    game.control()
    assert asked == [(game.folder / "controller", True)]
    assert game.controller_result is STOPPED
    assert not game.over
    assert game.error == ""


# how it ends


def test_a_game_without_a_try_leaves_nothing(game, capsys):
    assert _conclude(game) == Exit.DONE
    assert not game.folder.exists()
    assert capsys.readouterr().err == "no direction was given, so nothing was logged\n"


def test_a_game_with_tries_prints_them_and_where_the_logs_are(game, capsys):
    game.own_results = [ended()]
    assert _conclude(game) == Exit.DONE
    said = capsys.readouterr()
    assert said.out == "you 30.0 mm in 12 s\n"
    assert said.err.splitlines()[1] == f"  tetractl replay {game.folder}/you"
    assert "disturbances" not in said.err
    game.controller_result = ended([5.0])
    assert _conclude(game) == Exit.DONE
    said = capsys.readouterr()
    assert said.out == "you 30.0 mm in 12 s, the controller 5.00 mm in 12 s\n"
    assert "this spec simulates no disturbances" in said.err


def test_an_error_and_an_interruption_have_their_exit_codes(game, capsys):
    game.own_results = [ended()]
    game.error = "the radio is silent"
    assert _conclude(game) == Exit.FAILED
    assert capsys.readouterr().err.endswith("error: the radio is silent\n")
    game.error = ""
    assert _conclude(interrupted(game)) == Exit.INTERRUPTED
    assert capsys.readouterr().err.endswith("interrupted\n")


def test_an_interruption_before_any_direction_is_no_missing_direction(game, capsys):
    assert _conclude(interrupted(game)) == Exit.INTERRUPTED
    assert capsys.readouterr().err == "interrupted\n"


# which trial comes next


@pytest.mark.parametrize(
    ("answers", "trials_run"),
    [
        ([""], ["you"]),
        ([CONTINUE_KEY, CONTINUE_KEY], ["you", "controller"]),
        ([REPEAT_KEY, REPEAT_KEY, ""], ["you", "you", "you"]),
        ([CONTINUE_KEY, REPEAT_KEY, CONTINUE_KEY], ["you", "controller", "you"]),
        ([REPEAT_KEY, CONTINUE_KEY, ""], ["you", "you", "controller"]),
    ],
)
def test_keys_between_trials_choose_the_next_one(game, monkeypatch, answers, trials_run):
    left = list(answers)
    run = []

    def you(*_):
        run.append("you")
        return left.pop(0)

    def controller(*_):
        run.append("controller")
        game.controller_result = ended()
        return left.pop(0)

    monkeypatch.setattr(play, "_run_own_trial", you)
    monkeypatch.setattr(play, "_run_controller_trial", controller)
    _play_on_terminal(game, None, 1.0)
    assert run == trials_run
    assert left == []


def test_no_trial_follows_once_the_game_is_over(game, monkeypatch):
    def you(*_):
        game.over = True
        return REPEAT_KEY

    monkeypatch.setattr(play, "_run_own_trial", you)
    _play_on_terminal(game, None, 1.0)
    assert game.over
