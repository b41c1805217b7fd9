"""Camera and robots do what the lab relies on, before their emulated sides, in virtual time."""

from tetractl_emulator.contract import check_lab
from tetractl_vw import TEMPLATES

import tetractl


def test_the_lab_relies_on_nothing_that_is_missing(tmp_path):
    spec = (TEMPLATES / "robots" / "vw.yaml").read_text().replace("@NAME@", "name: vw")
    (tmp_path / "vw.yaml").write_text(spec)
    experiment = tetractl.load_spec(tmp_path / "vw.yaml").experiment
    check_lab(experiment.lab, experiment.setup)
