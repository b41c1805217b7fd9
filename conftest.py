"""Settings of all tests; each file says by its marks which tier its tests belong to."""

import gc

from hypothesis import settings
from testkit.running import take_signals

# No deadline: a slow machine is no failure. The same cases every time: what passed here passes
# there. New ones are looked for by `pytest --hypothesis-profile explore`.
settings.register_profile("tetractl", deadline=None, derandomize=True, max_examples=50)
settings.register_profile("explore", deadline=None)
settings.load_profile("tetractl")

take_signals()
gc.disable()  # until all tests are collected: nothing of them is garbage


def pytest_collection_finish() -> None:
    """Leave what was imported and collected, which stays until the end, to no later collection."""
    gc.freeze()
    gc.enable()
