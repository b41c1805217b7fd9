"""Tests of the faults with which a lab is rehearsed: those of its emulated devices."""

import pytest
from testkit.emulator.device_specs import APRILTAG_SPEC, TWIST_SPEC
from testkit.lab_specs import SPEC
from testkit.paths import EXAMPLES
from tetractl_emulator.fault_rows import FaultRow
from tetractl_emulator.faults import fault_kind
from tetractl_emulator.rehearsal.day_plan import plan_of_day, rows_of
from tetractl_emulator.script import DeviceClasses, parse_script
from tetractl_emulator.twist.side import EmulatedTwist

from tetractl.spec.load import load_spec, parse_spec
from tetractl.spec.yaml.core_yaml import format_yaml


def lab_of(spec):
    experiment = parse_spec(spec, "lab.yaml").experiment
    return experiment.lab, experiment.setup


def rows_of_spec(spec):
    return rows_of(*lab_of(spec))


def test_another_program_may_drive_m3pi_robots_and_those_that_take_lines():
    of_m3pi = {row.name for row in rows_of_spec(SPEC)}
    of_lines = {row.name for row in rows_of_spec(TWIST_SPEC)}
    assert of_m3pi == of_lines
    assert {"second sender", "sender as robots stop", "sender before the run"} <= of_lines


@pytest.mark.long
@pytest.mark.parametrize("name", ["tetrahymena_dish", "tetrahymena_lab", "tags"])
def test_days_of_cells_and_of_pictures_are_valid_scripts(name):
    """Every row is drawn; a dish from which trials choose has its own cells."""
    loaded = parse_spec(APRILTAG_SPEC, "lab.yaml")
    loaded = loaded if name == "tags" else load_spec(EXAMPLES / f"{name}.yaml")
    lab = loaded.experiment.lab
    setup = loaded.experiment.setup
    chosen = loaded.experiment.must_choose_robots
    met = set()
    for day in range(400):
        plan = plan_of_day(1, day, lab, setup, chosen)
        met |= {fault["kind"] for fault in plan.faults}
        if day % 4 == 0:
            text = format_yaml(plan.script())
            script = parse_script(text, "day.yaml", lab.camera.type, lab.actuator.type)
            assert len(script.faults) == len(plan.faults)
            assert bool(script.emulation.robots) == (not chosen)
    assert met == {row.name for row in rows_of(lab, setup)}


def test_cells_can_have_what_pictures_coils_and_cells_have_and_nothing_of_wheels():
    experiment = load_spec(EXAMPLES / "tetrahymena_dish.yaml").experiment
    names = {row.name for row in rows_of(experiment.lab, experiment.setup)}
    assert {"blurred", "knocked", "pictures late", "coils turned", "cell divides"} < names
    assert {"killed", "suspended", "disk full", "second run"} < names
    assert not names & {"wheel stuck", "pose frozen", "ghost turns", "radio late"}


def test_one_robot_is_not_swapped_with_itself():
    lab, setup = lab_of(SPEC)
    of_one = {row.fault for row in rows_of(lab, setup.select_robots([0]))}
    assert {row.fault for row in rows_of(lab, setup)} - of_one == {
        "swap",
        "swapped_numbers",
        "twin_id",
    }


@pytest.mark.long
def test_days_of_lines_are_valid_scripts_with_a_world_of_their_own():
    lab, setup = lab_of(TWIST_SPEC)
    for day in range(100):
        plan = plan_of_day(1, day, lab, setup)
        script = parse_script(format_yaml(plan.script()), "day.yaml", "optitrack", "twist")
        assert len(script.faults) == len(plan.faults)
        assert {robot.name for robot in script.emulation.actuator.robots} == {"green", "blue"}


def test_a_side_of_its_own_takes_part_with_its_faults(monkeypatch):
    class Own(EmulatedTwist):
        faults = (
            fault_kind(
                "flood",
                "Water.",
                rows=[FaultRow("flood", "wet"), FaultRow("drip", "damp", weight=2.0)],
            ),
        )

    camera = DeviceClasses.of_types("optitrack", "twist").camera
    monkeypatch.setattr(DeviceClasses, "of_types", lambda *_: DeviceClasses(camera, Own))
    rows = {row.name: row for row in rows_of_spec(TWIST_SPEC)}
    assert rows["drip"].fault == "flood"
    assert "frames lost" in rows
    assert "wheel stuck" not in rows
