"""The files that a spec draws on."""

from pathlib import Path

import pytest

from tetractl.core.errors import SpecError
from tetractl.core.trial import OWN_FILES
from tetractl.experiment.attached import attach
from tetractl.log.format import channels


def test_files_are_attached_by_their_names():
    one = attach((), Path("a/robots.yaml"), "one")
    assert attach(one, Path("b/cameras.yaml"), "two") == (
        ("robots.yaml", "one"),
        ("cameras.yaml", "two"),
    )


@pytest.mark.parametrize("name", ["robots.yaml", *sorted(OWN_FILES)])
def test_a_name_that_a_log_has_already_is_refused(name):
    attached = attach((), Path("robots.yaml"), "one")
    with pytest.raises(SpecError, match=f"b/{name}: the log of a trial holds another {name}"):
        attach(attached, Path("b") / name, "two")


def test_every_file_of_the_logs_own_is_known():
    own = {channels.SPEC, channels.RESOLVED_SPEC, channels.ENVIRONMENT, channels.LAYOUT}
    assert own == OWN_FILES
