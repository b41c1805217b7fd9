"""Pytest configuration: damage hits the same records of a log in every test run."""

import pytest

from tetractl.log import provenance


@pytest.fixture(autouse=True, scope="module")
def same_size_everywhere():
    """Leave out of logs what depends on the machine and on uncommitted changes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(provenance, "environment", lambda: "{}")
        yield
