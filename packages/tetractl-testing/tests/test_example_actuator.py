"""The actuator of the example package keeps the contract of actuators."""

import pytest
from testkit.labs import SteppedClock
from testkit.paths import ROOT
from testkit.trials import experiment
from tetractl_testing import device_checks
from tetractl_testing.device_checks import MovedRobots, check_actuator

from tetractl.core.errors import AbortError


@pytest.fixture
def csv_actuator(monkeypatch):
    """The module of the example; devices in virtual time do at once what they shall, or never."""
    monkeypatch.setattr(device_checks, "EMULATED_TIMEOUT_S", 0.3)
    monkeypatch.syspath_prepend(ROOT / "examples" / "tetractl-example")
    from tetractl_example import csv_actuator

    return csv_actuator


def test_each_command_is_a_row(csv_actuator, tmp_path):
    file = tmp_path / "rows.csv"
    setup = experiment().setup

    def actions() -> list[str]:
        return [line.split(",")[1] for line in file.read_text("utf-8").splitlines()]

    def moves() -> list[bool]:
        return [actions()[-1:] not in ([], ["stop"])] * len(setup.names)

    section = csv_actuator.CsvActuatorSection(type="csv-actuator", file=str(file))
    check_actuator(section, setup, MovedRobots(SteppedClock(), moves, None))
    assert set(actions()) == {"steer", "turn", "stop"}


def test_a_folder_that_does_not_exist_is_named(csv_actuator, tmp_path):
    file = tmp_path / "none" / "rows.csv"
    section = csv_actuator.CsvActuatorSection(type="csv-actuator", file=str(file))
    with pytest.raises(AbortError, match=r"rows\.csv: No such file"):
        section.build(experiment().setup, SteppedClock()).__enter__()
