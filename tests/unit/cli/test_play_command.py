"""Tests of the command `play`: what it refuses, and who steers how."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import pytest
from testkit.paths import ROOT

from tetractl.cli import play as module
from tetractl.cli.play import play
from tetractl.core.errors import Exit, UsageError
from tetractl.run.interrupt import Interrupt
from tetractl.spec.load import load_spec
from tetractl.spec.plants import select_plant

SPEC = load_spec(ROOT / "experiments/three_m3pi.yaml")
LAB = select_plant(load_spec(ROOT / "experiments/three_m3pi_lab.yaml"), "lab")


@pytest.fixture
def game(monkeypatch, tmp_path):
    """Play without a terminal and without trials; returns what happened."""
    done = SimpleNamespace(spec=SPEC, terminal=True, pictures=True, events=[], over=False)

    class Game(module.Game):
        def steer(self, ask, *_, **__):
            done.events.append("you, by a script")
            self.over = done.over

        def control(self, *_):
            done.events.append("the controller")

    def stoppable(directed, options, by_keys):
        done.by_keys = by_keys
        return nullcontext(Interrupt())

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(module, "Game", Game)
    monkeypatch.setattr(module, "load_to_run", lambda *_: done.spec)
    monkeypatch.setattr(module, "has_keys", lambda: done.terminal)
    monkeypatch.setattr(module.ui, "has_keys", lambda: done.terminal)
    monkeypatch.setattr(
        "tetractl.view.terminal.screen.can_show_screens", lambda console: done.pictures
    )
    monkeypatch.setattr(
        "tetractl.view.terminal.hand_keys.read_key_script",
        lambda path: SimpleNamespace(ask=lambda *_: None),
    )
    monkeypatch.setattr("tetractl.control.methods.build.warm_up", lambda *_: None)
    monkeypatch.setattr("tetractl.run.folder_lock.locked", lambda folder: nullcontext())
    monkeypatch.setattr(module, "stop_on_signals", stoppable)
    monkeypatch.setattr(
        module,
        "_play_in_lab",
        lambda game, console, ask_to_place: done.events.append(f"in the lab, ask {ask_to_place}"),
    )
    monkeypatch.setattr(
        module,
        "_play_on_terminal",
        lambda game, console, speed: done.events.append(f"on the terminal, {speed} times"),
    )
    monkeypatch.setattr(module, "_conclude", lambda game: Exit.DONE)
    monkeypatch.setattr(
        "tetractl.api.drawings.play_page", lambda spec, file: done.events.append(f"page {file}")
    )
    return done


SCRIPT = Path("keys.txt")


def test_a_simulation_is_steered_on_a_terminal(game):
    assert play(Path("s.yaml")) == Exit.DONE
    assert game.events == ["on the terminal, 1.0 times"]
    assert game.by_keys is True
    play(Path("s.yaml"), speed=3.0)
    assert game.events[-1] == "on the terminal, 3.0 times"


@pytest.mark.parametrize(("terminal", "pictures"), [(False, True), (True, False), (False, False)])
def test_keys_need_a_terminal_that_shows_pictures(game, terminal, pictures):
    game.terminal, game.pictures = terminal, pictures
    with pytest.raises(UsageError, match="play reads keys from a terminal") as caught:
        play(Path("s.yaml"))
    assert "--script FILE" in caught.value.hint
    assert game.events == []


@pytest.mark.parametrize("over", [False, True])
def test_a_script_needs_no_terminal_and_the_controller_follows_unless_it_is_over(game, over):
    game.terminal = game.pictures = False
    game.over = over
    assert play(Path("s.yaml"), script=SCRIPT) == Exit.DONE
    assert game.events == ["you, by a script"] + ["the controller"] * (not over)
    assert game.by_keys is False


def test_a_script_runs_as_fast_as_possible(game):
    with pytest.raises(UsageError, match="--speed cannot be combined with --script"):
        play(Path("s.yaml"), script=SCRIPT, speed=2.0)


@pytest.mark.parametrize(
    "options", [{"script": SCRIPT}, {"speed": 2.0}, {"script": SCRIPT, "speed": 2.0}]
)
def test_robots_in_a_lab_are_steered_by_a_person_in_real_time(game, options):
    game.spec = LAB
    with pytest.raises(UsageError, match="work only in virtual time: in the lab, a person"):
        play(Path("s.yaml"), yes=True, **options)
    assert game.events == []


@pytest.mark.parametrize("yes", [False, True])
def test_in_a_lab_robots_are_placed_by_a_person_unless_yes(game, yes):
    game.spec = LAB
    assert play(Path("s.yaml"), yes=yes) == Exit.DONE
    assert game.events == [f"in the lab, ask {not yes}"]


@pytest.mark.parametrize("options", [{"script": SCRIPT}, {"speed": 2.0}, {"out": Path("out")}])
def test_a_page_is_only_written(game, options, capsys):
    with pytest.raises(UsageError, match="--html writes a page"):
        play(Path("s.yaml"), html=Path("a.html"), **options)
    assert game.events == []
    game.terminal = False
    assert play(Path("s.yaml"), html=Path("a.html")) == Exit.DONE
    assert game.events == ["page a.html"]
    assert capsys.readouterr().err.startswith("wrote a.html: open it in a browser")


def test_a_folder_that_holds_something_is_refused(game, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "file").touch()
    with pytest.raises(UsageError, match="exists already"):
        play(Path("s.yaml"), out=tmp_path / "out")
    assert game.events == []
    assert play(Path("s.yaml"), out=tmp_path / "new") == Exit.DONE
