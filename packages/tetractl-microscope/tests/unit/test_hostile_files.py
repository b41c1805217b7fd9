"""Tests that no answer of a camera and no table of the field can do harm."""

import random

import pytest
from testkit.bounded_work import withstands
from testkit.microscope.picture_targets import TARGETS
from testkit.targets import mutant, only
from tetractl_microscope.tracks.field_file import read_field

from tetractl.core.errors import TetractlError

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_a_camera_may_answer_anything():
    withstands(TARGETS["pictures"])


def test_any_table_of_the_field_is_read_or_refused(tmp_path):
    path = tmp_path / "field.csv"
    rng = random.Random(1)
    good = "time_s,direction_rad,strength\n" + "".join(f"{k / 9},{k % 3},1\n" for k in range(60))
    for _ in range(30):
        path.write_bytes(mutant([good.encode()], rng))
        with only(TetractlError, one_line=False):
            read_field(path)
