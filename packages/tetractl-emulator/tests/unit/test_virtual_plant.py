"""The section of plant `emulated`."""

from support.lab_processes import SPEC

from tetractl.experiment.load import load_spec
from tetractl.experiment.plants import on_plant

CALIBRATION = """
measured: 2026-01-01
actuator: {robots: [{name: green, swap: true}]}
"""


def test_a_calibrated_lab_still_records_what_truly_happens(tmp_path):
    """Regression: a calibration dropped `record`, which no log has, so that a rehearsal of a
    calibrated lab observed nothing."""
    file = tmp_path / "calibration.yaml"
    file.write_text(CALIBRATION)
    sets = ("lab.type=emulated", "lab.record=truth", f"lab.calibration={file}")
    plant = on_plant(load_spec(SPEC, sets), "emulated").experiment.plant
    assert plant.actuator.robot("green").swap
    assert plant.record == "truth"
