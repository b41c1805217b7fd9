"""Damage to logs falls on the same records wherever the tests run."""

import pytest

from tetractl.log import provenance


@pytest.fixture(autouse=True, scope="module")
def same_size_everywhere():
    """Leave out of logs what depends on the machine and on uncommitted changes."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(provenance, "environment", lambda: "{}")
        yield
