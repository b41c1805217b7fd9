"""Settings of all tests: which are slow, in what order they run, and in which process."""

from pathlib import Path

import pytest
from hypothesis import settings

# No deadline: a slow machine is no failure. The same cases every time: what passed here passes
# there. New ones are looked for by `pytest --hypothesis-profile explore`.
settings.register_profile("tetractl", deadline=None, derandomize=True)
settings.register_profile("explore", deadline=None)
settings.load_profile("tetractl")

FOLDER = Path(__file__).parent
SLOW = (  # tests that start processes, compile, draw pictures or try very many cases
    "cli",
    "contract",
    "emulated",
    "unit/control/kernels",
    "unit/experiment/test_fuzz",
    "unit/lab/cameras/apriltag",
    "unit/log/read/test_salvage",
    "unit/test_hostile",
)
LANES = 2  # plays of an emulated lab at a time: each has deadlines to keep
TURNS = ("emulated", "cli/test_docs", "cli", "")  # what takes longest is started first


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what is slow, and choose which tests follow one another in one process.

    A module's tests do, as they share fixtures, but for those marked as slow one by one.
    """
    places = {item: item.path.relative_to(FOLDER).as_posix() for item in items}
    items.sort(key=lambda item: next(i for i, t in enumerate(TURNS) if places[item].startswith(t)))
    for number, item in enumerate(items):
        folder = places[item].partition("/")[0]
        alone = any(mark.name == "slow" for mark in item.own_markers)
        group = item.name if alone else places[item]
        if places[item].startswith(SLOW):
            item.add_marker(pytest.mark.slow)
        if folder == "emulated":
            group = f"lane {number % LANES}"
        item.add_marker(pytest.mark.xdist_group(group))
