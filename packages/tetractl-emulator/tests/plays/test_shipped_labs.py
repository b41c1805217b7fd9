"""Every lab that is shipped, as an example or as a template of `init --lab`, runs silently in its
emulator: no trial of a batch is flagged, since nothing goes wrong in it.
"""

import pytest
from support.cli import tetractl
from support.silent_labs import flagged_trials

from tetractl.experiment.examples import examples
from tetractl.experiment.yaml.document import read_document

pytestmark = [pytest.mark.slow, pytest.mark.long]

LABS = {name: file for name, file in examples().items() if "lab" in read_document(file).data}
TEMPLATES = [
    ("m3pi-xbee", "optitrack"),
    ("m3pi-xbee", "apriltag"),
    ("twist", "optitrack"),
    ("twist", "apriltag"),
    ("twist", "motioncapture"),
    ("toio", "toio"),
]


@pytest.mark.parametrize("name", LABS)
def test_no_trial_of_a_shipped_lab_is_flagged(tmp_path, name):
    """Regression: 8 of 8 trials of three_m3pi_lab said that the model does not fit.

    The published controller does not know where the arena ends: an abort is no warning.
    """
    logs = flagged_trials(LABS[name], tmp_path / "logs")
    if name == "three_m3pi_paper_lab":
        logs = [log for log in logs if log.outcome != "aborted"]
    assert logs == []


@pytest.mark.parametrize(("robots", "camera"), TEMPLATES)
def test_no_trial_of_a_new_lab_is_flagged(tmp_path, robots, camera):
    words = ("init", "lab", "--lab", "--robots", robots, "--camera", camera)
    tetractl(tmp_path, *words).ok()
    assert flagged_trials(tmp_path / "lab.yaml", tmp_path / "logs") == []
