"""Tests of `tetractl play`: steering by hand on a terminal, and with a file of keys."""

import re
import sys
from dataclasses import replace

import pytest
from testkit.cli import tetractl
from testkit.running import TETRACTL
from testkit.terminal import Terminal
from testkit.trials import three_robots

import tetractl as package
from tetractl import load_spec
from tetractl.cli.play import _describe_error, _find_best, _suggest_disturbances
from tetractl.spec.section_abilities import GivenDirections

pytestmark = pytest.mark.slow

SPEC = """
name: by-hand
arena: {left: 0, bottom: 0, width: 1000, height: 1000}
robots:
  - {name: a, start: [300, 500], target: [400, 500], a: 3, speed: 100}
  - {name: b, start: [300, 300], target: [400, 300], a: 2, speed: 100}
wheels: {radius: 40}
obstacles: [{type: circle, center: [700, 700], radius: 50}]
controller: {type: pso-mpc, horizon_max: 8, optimizer: {particles: 10, iterations: 5}}
plant: {type: sim, a_error: 0.1, speed_error: 0.1, heading_noise: 0.02}
trials: {count: 3, seed: 5}
"""


@pytest.fixture
def folder(tmp_path):
    """A folder with a spec and a file of keys."""
    (tmp_path / "spec.yaml").write_text(SPEC)
    (tmp_path / "keys.txt").write_text("0 right\n1 space\n")
    return tmp_path


@pytest.mark.long
def test_a_script_steers_and_the_controller_does_the_same_trial(folder):
    done = tetractl(folder, "play", "spec.yaml", "--script", "keys.txt", "-o", "out").ok()
    number = r"[\d.]+ mm in \d+ s"
    assert re.fullmatch(rf"you {number}, the controller {number}\n", done.stdout)
    assert done.stderr.splitlines() == [
        "the logs are in out; look at them with:",
        "  tetractl replay out/you out/controller",
    ]
    yours = package.read_log(folder / "out/you/trial-000.mcap")
    theirs = package.read_log(folder / "out/controller/trial-000.mcap")
    assert isinstance(yours.experiment.controller, GivenDirections)
    assert [step.plan.direction for step in yours.steps] == [0.0] * 5
    assert yours.start.seed == theirs.start.seed == 5
    assert yours.mocap[0].tolist() == theirs.mocap[0].tolist()  # the same start and noise
    assert tetractl(folder, "verify", "out").ok().stdout.count("bit-identical") == 2
    stats = tetractl(folder, "stats", "out/you", "out/controller").ok().stdout
    assert "given directions" in stats
    assert "lower mean error" not in stats
    again = tetractl(folder, "rerun", "out/you/trial-000.mcap", "-o", "again").ok()
    assert "the content digests agree" in again.stderr


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ((), "play reads keys from a terminal with UTF-8, and there is none here"),
        (("--script", "none.txt"), "none.txt: there is no such file"),
        (("--script", "keys.txt", "-o", "."), ".: exists already"),
        (("--script", "keys.txt", "--set", "hold={radius: 90, time: 5}"), "nor a hold"),
        (("--script", "keys.txt", "--speed", "0"), "Invalid value for '--speed'"),
        (("--script", "keys.txt", "--speed", "2"), "--speed cannot be combined with --script"),
    ],
)
def test_what_cannot_be_played_is_one_line_and_exit_code_2(words, problem, folder):
    done = tetractl(folder, "play", "spec.yaml", *words)
    assert done.returncode == 2
    assert problem in done.stderr.splitlines()[0]
    assert len([line for line in done.stderr.splitlines() if line.startswith("error")]) == 1
    assert not (folder / "logs").exists()


def on_terminal(folder, *words):
    command = [TETRACTL, "play", "spec.yaml", "-o", "out", "--speed", "5", *words]
    return Terminal(command, folder)


def restored(terminal):
    """Check that the terminal is as it was: its settings, its screen and its mouse."""
    assert terminal.settings() == terminal.before
    assert terminal.raw.rindex("\x1b[?1049l") > terminal.raw.rindex("\x1b[?1049h")
    assert terminal.raw.rindex("\x1b[?1002l") > terminal.raw.rindex("\x1b[?1002h")


def play(terminal, *moves):
    """Wait for each text, and then press its keys."""
    for text, keys in moves:
        terminal.expect(text)
        terminal.press(keys)


@pytest.mark.long
def test_keys_and_mouse_steer_and_the_terminal_is_restored(folder):
    with on_terminal(folder) as terminal:
        play(
            terminal,
            ("arrows steer", "\x1b[A"),
            (r"↑ \+90°", "p"),
            ("PAUSED", "\x1b[D"),
            (r"← \+180°", "p"),
            ("arrows steer", "\x1b[<0;20;10M\x1b[<32;24;8M"),
            (r"↗ \+45°", " "),
            (r"You: [\d.]+ mm in \d+ s\. All robots", ""),
            ("ENTER: the controller  R: again", "\x1b[A\r"),  # the arrow answers nothing
            (r"Your best: [\d.]+ mm in \d+ s", ""),
            ("ENTER: end", "\r"),
        )
        terminal.expect(r"you [\d.]+ mm in \d+ s.*, the controller [\d.]+ mm in \d+ s")
        terminal.expect("logs are in out")
        restored(terminal)
        assert "Traceback" not in terminal.raw
        assert terminal.finish() == 0
    yours = package.read_log(folder / "out/you/trial-000.mcap")
    assert yours.result.outcome == "sequence completed"


BROKEN = """
from tetractl.run.hand import HandController
from tetractl.cli import main

def decided(self, *args):
    self._ask(0.0)
    raise RuntimeError("a defect")

HandController.decided = decided
main()
"""


@pytest.mark.long
def test_the_terminal_is_restored_after_a_defect(folder):
    with Terminal([sys.executable, "-c", BROKEN, "play", "spec.yaml"], folder) as terminal:
        play(terminal, ("arrows steer", "\x1b[A"))
        terminal.expect(r"Traceback[\s\S]*RuntimeError: a defect")
        restored(terminal)
        assert terminal.finish() == 1


@pytest.mark.long
def test_ctrl_c_stops_the_robots_first_and_the_log_is_whole(folder):
    with on_terminal(folder) as terminal:
        play(terminal, ("arrows steer", "\x1b[C"), (r"→ \+0°", "\x03"))
        terminal.expect("logs are in out")
        terminal.expect("interrupted")
        restored(terminal)
        assert "Traceback" not in terminal.raw
        assert terminal.finish() == 130
    yours = package.read_log(folder / "out/you/trial-000.mcap")
    assert yours.result.outcome == "interrupted"
    assert tetractl(folder, "verify", "out").ok()
    assert not (folder / "out/controller").exists()


@pytest.mark.long
@pytest.mark.parametrize(("key", "code"), [(" ", 0), ("\x03", 130), ("\x1a", 130)])
def test_a_trial_that_is_left_before_its_first_key_leaves_no_log(key, code, folder):
    with on_terminal(folder) as terminal:
        play(terminal, ("arrows steer", key))
        terminal.expect("nothing was logged" if code == 0 else "interrupted")
        restored(terminal)
        assert "Traceback" not in terminal.raw
        assert terminal.finish() == code
    assert not (folder / "out").exists()


def test_the_best_try_is_one_that_is_not_lost():
    result = three_robots().result
    outside = replace(result.verdict, edge=(-1.0, 100.0, 100.0))
    lost = replace(result, total_error=1.0, verdict=outside)
    kept = replace(result, total_error=9.0)
    assert lost.left_arena
    assert _find_best([lost, kept]) is kept
    assert _find_best([lost]) is lost


def test_errors_below_a_hundredth_of_a_millimetre_are_no_digits():
    """Regression: an undisturbed controller was 0.000519 mm off."""
    log = three_robots()
    result = replace(log.result, total_error=0.000519)
    assert _describe_error(result, log.experiment) == f"< 0.01 mm in {result.duration_s:.0f} s"
    assert _describe_error(replace(result, total_error=6.9), log.experiment).startswith(
        "6.90 mm in"
    )


CELL = {"JPY_PARENT_PID": "1", "TERM": "xterm-color", "FORCE_COLOR": "1", "CLICOLOR_FORCE": "1"}
"""What a command in a cell of a notebook finds in its environment."""


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["play", "spec.yaml"], 2, "play reads keys from a terminal with UTF-8"),
        (["run", "spec.yaml", "-o", "out"], 0, "look at one of them with: tetractl replay out"),
        (["run", "spec.yaml", "--plant", "lab"], 2, "error: "),
    ],
)
def test_a_cell_of_a_notebook_is_no_terminal(words, code, says, folder):
    """`!tetractl run` wrote 315 kB of codes into the cell, and `!tetractl play` waited for ever."""
    with Terminal([TETRACTL, *words], folder, **CELL) as terminal:
        terminal.expect(says)
        assert terminal.finish() == code
    assert "\x1b" not in terminal.raw


def test_only_a_spec_without_disturbances_is_said_to_have_none(folder, monkeypatch):
    """Regression: "robots do exactly what the controller expects", with a controller that expects
    straight lines."""
    monkeypatch.chdir(folder)
    disturbed = load_spec("spec.yaml")
    exact = load_spec("spec.yaml", "plant={type: sim}")
    assert _suggest_disturbances(disturbed.experiment) == []
    first, *commands = _suggest_disturbances(exact.experiment)
    assert "no disturbances" in first
    assert "controller" not in first
    assert commands == [
        "  tetractl init --example three_m3pi_bench",
        "  tetractl play experiments/three_m3pi_bench.yaml",
    ]
    assert tetractl(folder, "init", "--example", "three_m3pi_bench").ok()
    assert _suggest_disturbances(exact.experiment)[1:] == commands[1:]
