"""Tests of logs in which robots drove with the field off.

Such logs can be read, verified and shown. Commands that need a direction in every step refuse them.
"""

import json

import pytest
from testkit.trials import THREE_M3PI

from tetractl.core.commands import FieldOff
from tetractl.log.read.reader import read_trial
from tetractl.report.trial_data import trial_data
from tetractl.run.logged_trial import log_path, run_logged
from tetractl.spec.load import parse_spec
from tetractl.verification.verify import verify
from tetractl.view.figures.draw import draw
from tetractl.view.player import Recording
from tetractl.view.terminal.replay_screen import format_step

pytestmark = pytest.mark.slow

TIME_LIMIT_S = 8.2
STEPS = 41  # in that time, one every 0.2 s
WHEELS = {"drive": {"rate": 40, "lag": 0.04}, "type": "sim"}
CELLS = {"type": "sim", "lost_commands": 0.2, "heading_noise": 0.1}


@pytest.fixture(scope="module", params=[CELLS, WHEELS], ids=["cells", "wheels"])
def path(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    data = THREE_M3PI | {
        "controller": {"type": "ensemble", "time_limit": TIME_LIMIT_S},
        "plant": request.param,
        "wheels": {"radius": 40},
    }
    run_logged(parse_spec(json.dumps(data), "s.yaml"), folder)
    return log_path(folder, 0)


@pytest.fixture(scope="module")
def log(path):
    return read_trial(path)


def test_some_commands_switch_the_field_off_and_only_the_last_stops(log):
    off = [step.command.action == FieldOff() for step in log.steps]
    assert any(off)
    assert not all(off)
    assert [step.plan.action == FieldOff() for step in log.steps] == off
    assert [step.plan.direction is None for step in log.steps] == off
    *earlier, last = log.commands
    assert not any(command.stops for command in earlier)
    assert last.stops
    assert log.stop is last
    assert log.began_ns == log.commands[0].sent_ns


def test_it_is_verified_whole(path):
    verification = verify(path)
    assert verification.problems == ()
    assert verification.checked == STEPS


@pytest.mark.long
def test_it_is_shown(log):
    k = next(step.k for step in log.steps if step.command.action == FieldOff())
    assert "field off" in format_step(Recording(log), k)
    assert trial_data(log, "t")["steps"]["u"]
    for kind in ("trajectory", "errors", "over-time"):
        draw(kind, [log])
