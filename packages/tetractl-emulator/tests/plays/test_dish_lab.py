"""Tests in which a trial finds cells and steers them through synthetic images, in virtual time."""

import contextlib
import json
import re

import numpy as np
import pytest
from testkit.cli import tetractl
from testkit.emulator.lab_processes import flags
from testkit.emulator.virtual_lab import DISH, virtual_dish
from tetractl_emulator import firmware
from tetractl_microscope.coils.driver import DriverStatus

from tetractl.core.clock import SECOND
from tetractl.core.errors import AbortError
from tetractl.core.plan import Outcome
from tetractl.log.read.reader import read_trial
from tetractl.run.interrupt import Interrupt
from tetractl.run.logged_trial import run_logged
from tetractl.spec.load import load_spec
from tetractl.verification.verify import verify

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(firmware.compiler() is None, reason="no C compiler found"),
]

SMALL = (  # a smaller dish, coarser pictures, and few cells
    "lab.camera.um_px=4.5",
    "arena.width=2100",
    "arena.height=2100",
    "robots={choose: 2, targets: [[800, 800], [1300, 1300], [800, 1300]], a: 4, speed: 420, "
    "seconds: 4}",
    "controller.time_limit=12.2",
    "controller.accept_error=120",
)
FEW = "emulation: {actuator: {cells: 3, strangers: 1}, camera: {specks: 4}}\n"
EVERY_DAY = ("light, flicker: 0.03", "focus, by_um: 15", "half_rate", "bubble")


def run_trial(dish, folder):
    return run_logged(dish.spec, folder, 0, [], Interrupt(lambda number: None))


def survey(dish, folder, *words, **how):
    return tetractl(folder, "lab", "survey", DISH, *flags(dish.settings), *words, **how)


def driver_after(dish):
    """The field's driver a second later."""
    dish.clock.sleep_until(dish.clock.now() + SECOND)
    return dish.emulation.actuator.driver


def play(folder, script="", sets=(), seed=1):
    """Run a trial; return its log and the cells as they truly are then."""
    with virtual_dish(folder, seed, (*SMALL, *sets), FEW + script) as dish:
        run_trial(dish, folder)
        running = dish.emulation.actuator.driver.running
        return read_trial(folder / "trial-000.mcap"), dish.cells, running


def test_a_trial_finds_cells_learns_them_and_brings_them_to_targets(tmp_path):
    """While it steers, there is what a dish does every day."""
    lines = ", ".join(f"{{fault: {fault}, at: 5}}" for fault in EVERY_DAY)
    log, cells, running = play(tmp_path, f"faults: [{lines}]")
    setup = log.experiment.setup
    result = log.result
    assert result.outcome.complete, result.reason
    assert not log.experiment.must_choose_robots
    assert log.experiment.chosen.found
    final = result.verdict.final.array()
    assert setup.distances(final[:, :2]).sum() < 200
    gaps = np.hypot(final[:, :1] - cells.x, final[:, 1:2] - cells.y)
    who = gaps.argmin(axis=1)
    assert len(set(who.tolist())) == 2
    assert gaps.min(axis=1).max() < 100  # um: they swim on while the end is decided
    assert setup.a == pytest.approx(cells.a[who], rel=0.15)  # before any plan
    assert setup.speed == pytest.approx(cells.speed[who], rel=0.05)
    assert not running
    tetractl(tmp_path, "verify", tmp_path / "trial-000.mcap").ok()


@pytest.mark.parametrize(
    ("fault", "at_s", "says"),
    [
        ("light, share: 0.02", 2, "0 of 0 cells respond to the field"),
        ("off", 2, "the current driver does not answer"),
        ("light, share: 0.02", 6, "not tracked"),
    ],
)
def test_what_the_camera_cannot_show_steers_no_cell(tmp_path, fault, at_s, says):
    """Wrong pictures never steer: there is no trial, or it is aborted, and the field is off."""
    script = f"faults: [{{fault: {fault}, at: {at_s}}}]"
    sets = (*SMALL, "controller.accept_error=0.1")
    with virtual_dish(tmp_path, 7, sets, FEW + script) as dish:
        if at_s == 2:  # before the choice
            with pytest.raises(AbortError, match=says):
                run_trial(dish, tmp_path)
        else:
            result = run_trial(dish, tmp_path)
            assert result.outcome is Outcome.ABORTED
            assert says in result.reason
        assert not driver_after(dish).running


def test_a_cell_that_divides_is_replaced(tmp_path):
    script = "faults: [{fault: divides, cell: cell 1, at: 4.5}]"  # which is robot "cell 2" here
    log, cells, _ = play(tmp_path, script, ("controller.accept_error=40", "on_lost=replace"))
    result = log.result
    assert len(cells) == 5
    assert result.lost == (0, 1)
    assert result.outcome.complete
    text = " ".join(note.text for note in log.notes)
    assert "cell 2 has divided" in text
    assert "the run goes on without this robot" in text
    assert "cell 2 is now another cell" in text
    assert verify(tmp_path / "trial-000.mcap").problems == ()
    assert max(result.robot_errors) < 60


def test_stop_of_a_field_needs_no_more_of_a_spec_than_its_driver(tmp_path, monkeypatch):
    """Regression: the field stayed on if any other part of the spec was wrong."""
    with virtual_dish(tmp_path, 3, SMALL, FEW) as dish:
        monkeypatch.setattr("tetractl.cli.lab.MonotonicClock", lambda: dish.clock)
        sets = ("controller.typo=1", f"lab.actuator.port={tmp_path / 'radio'}")
        done = tetractl(tmp_path, "lab", "stop", DISH, *flags(sets)).ok()
        assert DriverStatus.EMERGENCY_STOPPED in driver_after(dish).status
    assert done.stdout == "sent 10 stops\n"
    assert "controller.typo" in done.stderr


def test_a_survey_sees_by_the_turning_of_cells_that_the_picture_is_mirrored(tmp_path):
    script = "emulation: {actuator: {cells: 7}, camera: {mirrored: true}}\n"
    with virtual_dish(tmp_path, 3, SMALL, script) as dish:
        done = survey(dish, tmp_path, "--yes", "--plans", "1")
        assert not driver_after(dish).running
    assert "warning: cells turn right when the field turns left" in done.stderr
    assert "is towards the mirror image of the field" in done.stdout


def test_a_survey_lists_cells_ranks_choices_and_writes_a_spec_that_finds_them_again(tmp_path):
    with virtual_dish(tmp_path, 2, SMALL, FEW) as dish:
        done = survey(dish, tmp_path, "--yes", "--plans", "4", "-o", "found.yaml").ok()
        magnets = np.sort(dish.cells.a[dish.cells.a > 0])
        again = survey(dish, tmp_path, "--yes", "--json", "--plans", "1").ok()
    items = json.loads(again.stdout)
    assert items["unit"] == "um"
    assert sum(cell["magnetised"] for cell in items["cells"]) >= len(items["choices"][0]["cells"])
    errors = [choice["error"] for choice in items["choices"] if choice["error"] is not None]
    assert errors == sorted(errors)
    listed = re.findall(r"cell \d+ at \(\d+, \d+\) um: "
                        r"a (-?[\d.]+) ± [\d.]+ rad/s, speed [\d.]+ ± [\d.]+ um/s"
                        r"(?:, was near .*)?$", done.stdout, re.MULTILINE)  # fmt: skip
    assert len(listed) >= 2
    gaps = np.abs(np.array(listed, float)[:, None] / magnets - 1).min(axis=1)
    assert gaps.max() < 0.1
    errors = re.findall(r"predicted mean total error ([\d.]+) um", done.stdout)
    assert [float(error) for error in errors] == sorted(map(float, errors))
    chosen = load_spec(tmp_path / "found.yaml").experiment.chosen
    assert chosen.choose == len(chosen.wanted) == 2
    assert all(np.abs(cell.a / magnets - 1).min() < 0.1 for cell in chosen.wanted)


def test_too_few_cells_that_answer_are_one_clear_error(tmp_path):
    few = "emulation: {actuator: {cells: 1, strangers: 2}, camera: {specks: 0}}\n"
    with virtual_dish(tmp_path, 3, SMALL, few) as dish:
        with pytest.raises(AbortError, match="cells respond to the field, but 2 are needed"):
            run_trial(dish, tmp_path)
        assert not driver_after(dish).running


def test_a_person_at_a_terminal_is_asked_before_the_field_turns(tmp_path, monkeypatch):
    """Regression: the page said so, and the field turned at once; then the question was on stdout,
    so that with `--json > cells.json` it was not seen."""
    monkeypatch.setattr("tetractl.cli.ui.require_yes_or_terminal", lambda yes: None)  # as at one
    with virtual_dish(tmp_path, 3, SMALL, FEW) as dish:
        done = survey(dish, tmp_path, stdin="n\n")
        assert dish.events("run") == []
    assert done.returncode != 0
    assert "The magnetic field will turn the cells for" in done.stderr
    assert done.stdout.strip() == ""


def test_a_key_is_the_emergency_stop_of_a_survey(tmp_path, monkeypatch):
    """Regression: keys did nothing while a survey turned the field."""

    class PressedKey(contextlib.nullcontext):
        listening = True

        def __init__(self, stop, enter):
            super().__init__(self)
            stop()

    monkeypatch.setattr("tetractl.cli.lab.StopKey", PressedKey)
    with virtual_dish(tmp_path, 3, SMALL, FEW) as dish:
        done = survey(dish, tmp_path, "--yes")
        assert DriverStatus.EMERGENCY_STOPPED in driver_after(dish).status
    assert done.returncode == 1
    assert "SPACE or ESC" in done.stderr
    assert "emergency stop by the operator" in done.stderr
