"""The template runs silently in its emulated lab: nothing goes wrong in it."""

import pytest
from testkit.emulator.silent_labs import flagged_trials
from tetractl_vw import TEMPLATES


@pytest.mark.slow
@pytest.mark.long
def test_no_trial_of_a_new_lab_is_flagged(tmp_path):
    spec = (TEMPLATES / "robots" / "vw.yaml").read_text().replace("@NAME@", "name: vw")
    (tmp_path / "vw.yaml").write_text(spec)
    assert flagged_trials(tmp_path / "vw.yaml", tmp_path / "logs") == []
