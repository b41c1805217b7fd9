"""Tests of `tetractl replay` and `plot`, started as a user would with and without a terminal."""

import os
import re
import shlex
import shutil
import signal
import sys
import termios
from pathlib import Path

import pytest
from testkit import cli
from testkit.running import first_of
from testkit.terminal import PATIENCE_S, Terminal
from testkit.trials import three_robots, write_torn, write_trial

from tetractl.cli.plot import plot
from tetractl.core.registries import FIGURES
from tetractl.log.read.reader import read_trial
from tetractl.view.plan_words import describe_search_end

pytestmark = pytest.mark.slow

TETRACTL = str(Path(sys.executable).with_name("tetractl"))
LFLAG = 3  # where the local modes are in what `termios.tcgetattr` returns


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    write_trial(folder / "whole.mcap")
    write_trial(folder / "other.mcap", seed=3)
    write_torn(folder / "cut.mcap.part")
    return folder


def run(*args, cwd):
    return cli.tetractl(cwd, *args)


def play(folder, *options, **env):
    return Terminal([TETRACTL, "replay", "whole.mcap", *options], folder, **env)


def step_lines(text):
    """The lines of control steps, without those of events."""
    return [line for line in text.splitlines() if "  k " in line]


def at(seconds):
    return re.escape(f"{seconds:.1f} / {three_robots().result.duration_s:.1f} s")


@pytest.mark.long
def test_every_key_reaches_the_player(folder):
    """What a key does there is tested of the player; here, what then stands on the screen."""
    with play(folder, "--paused") as terminal:
        terminal.expect("‖ 1×.*" + at(0.0))
        for keys, on_screen in (
            (".", "step k      1 "),
            ("\x1b[C", at(1.2)),
            ("\x1bOC", at(2.2)),
            ("\x1b[D", at(1.2)),
            ("+", "‖ 2×"),
            ("--", "‖ 0.5×"),
            (" ", "▶ 0.5×"),
            (" ", "‖ 0.5×"),
            ("\x1b[F", "ended: sequence completed"),
            (",", "step k      40 "),
            ("\x1b[H", at(0.0)),
            ("e", "sequence completed after 41 control steps"),
            ("E", "trial 0 of three-m3pi starts"),
            ("?", "Home End +start or end"),
            ("?", at(0.0)),
        ):
            terminal.press(keys)
            terminal.expect(on_screen)
        terminal.press("q")
        assert terminal.finish() == 0
        assert terminal.settings() == terminal.before
        assert terminal.raw.rstrip().endswith(("\x1b[?25h", "\x1b[?1049l"))


@pytest.mark.system
def test_it_follows_the_size_of_the_terminal(folder):
    with play(folder, "--paused") as terminal:
        terminal.expect("solve time|step k")
        terminal.resize(40, 12)
        terminal.expect("time  .*0.0 / 8…")
        terminal.resize(120, 40)
        terminal.expect("evaluations")
        terminal.press("q")
        assert terminal.finish() == 0


@pytest.mark.long
@pytest.mark.parametrize(
    "how",
    [
        *first_of(["ctrl-c", "SIGTERM", "SIGHUP"]),
        pytest.param("ctrl-c again and again", marks=pytest.mark.system),
    ],
)
def test_an_interrupt_gives_the_terminal_back(folder, how):
    with play(folder) as terminal:
        terminal.expect("▶ 1×")
        assert not terminal.settings()[LFLAG] & termios.ICANON
        if how == "ctrl-c":
            terminal.press("\x03")
        elif how == "ctrl-c again and again":
            for _ in range(20):
                os.kill(terminal.process.pid, signal.SIGINT)
        else:
            os.kill(terminal.process.pid, getattr(signal, how))
        assert terminal.process.wait(PATIENCE_S) == 130
        assert terminal.settings() == terminal.before
        terminal.finish()
        assert terminal.raw.rindex("\x1b[?1049l") > terminal.raw.rindex("\x1b[?1049h")
        assert terminal.raw.rindex("\x1b[?25h") > terminal.raw.rindex("\x1b[?25l")
        assert "error: " not in terminal.raw
        assert "Traceback" not in terminal.raw


@pytest.mark.system
def test_ctrl_z_leaves_the_terminal_usable_and_fg_goes_on(folder):
    script = f"""set -m
{shlex.quote(TETRACTL)} replay whole.mcap --paused
echo "stopped=$?"; stty -a; fg; echo "ended=$?"
"""
    with Terminal(["bash", "-c", script], folder) as terminal:
        terminal.expect(at(0.0))
        terminal.press("\x1a")
        terminal.expect("stopped=148")
        terminal.expect(r"[^-]icanon[\s\S]*[^-]echo ")
        terminal.expect(at(0.0))
        terminal.press(".")
        terminal.expect("step k      1 ")
        terminal.press("q")
        terminal.expect("ended=0")
        assert terminal.finish() == 0


def test_without_a_terminal_one_line_a_step(folder):
    done = run("replay", "whole.mcap", cwd=folder)
    assert (done.returncode, done.stderr) == (0, "")
    lines = step_lines(done.stdout)
    steps = three_robots().steps
    assert len(lines) == len(steps)
    events = [line for line in done.stdout.splitlines() if line not in lines]
    assert events == [
        "  0.00 s  info: trial 0 of three-m3pi starts",
        "  8.20 s  info: sequence completed after 41 control steps",
        "  8.20 s  sequence completed, final total error 83.8 mm true",
    ]
    for line, step in zip(lines, steps, strict=True):
        assert f"k {step.k} " in line
        assert f"evaluations {step.plan.evaluations} " in line
        assert line.endswith(describe_search_end(step.plan.search))
    assert "\x1b" not in done.stdout


@pytest.mark.long
def test_a_damaged_log_shows_what_is_left_and_says_so(folder):
    done = run("replay", "cut.mcap.part", cwd=folder)
    assert done.returncode == 1
    steps = read_trial(folder / "cut.mcap.part").steps
    assert len(step_lines(done.stdout)) == len(steps)
    assert done.stderr.startswith("damaged: cut.mcap.part: ")
    assert "lost: cut.mcap.part: " in done.stderr
    done = run("plot", "cut.mcap.part", "--kind", "errors", cwd=folder)
    assert (done.returncode, done.stdout) == (1, "cut-errors.png\n")
    assert (folder / "cut-errors.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.long
@pytest.mark.parametrize("kind", first_of(["trajectory", "convergence", "errors", "over-time"]))
def test_plot_names_its_file_after_the_log_here(folder, tmp_path, kind):
    done = run("plot", folder / "whole.mcap", "--kind", kind, cwd=tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, f"whole-{kind}.png\n", "")
    assert [path.name for path in tmp_path.iterdir()] == [f"whole-{kind}.png"]


def test_the_help_explains_each_figure():
    text = plot.__doc__ or ""
    assert [kind for kind in FIGURES.builtin if f"\n    {kind}: " not in text] == []


@pytest.mark.long
def test_a_figure_of_two_folders_is_named_after_what_holds_them(folder, tmp_path):
    for arm in ("ours", "paper"):
        (tmp_path / "demo" / arm).mkdir(parents=True)
        shutil.copy(folder / "whole.mcap", tmp_path / "demo" / arm)
    done = run("plot", "demo", "--kind", "errors", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (0, "demo-errors.png\n"), done.stderr
