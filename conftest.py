"""Settings of all tests: which tier a test belongs to, in what order tests run, in which process.

`make test-fast` leaves out what is `slow`, `make test` what is `system`; `make test-all` runs what
is `system`.
"""

import re

import pytest
from hypothesis import settings

# No deadline: a slow machine is no failure. The same cases every time: what passed here passes
# there. New ones are looked for by `pytest --hypothesis-profile explore`.
settings.register_profile("tetractl", deadline=None, derandomize=True, max_examples=50)
settings.register_profile("explore", deadline=None)
settings.load_profile("tetractl")

SLOW = (  # tests that start processes, compile, draw pictures or try very many cases
    "cli",
    "contract",
    "emulated",
    "plays",
    "unit/analysis/test_analyze",
    "unit/control/kernels",
    "unit/control/optimizers",
    "unit/control/test_build",
    "unit/control/test_filter",
    "unit/experiment/test_fuzz",
    "unit/experiment/yaml",
    "unit/film",
    "unit/test_firmware",
    "unit/apriltag",
    "unit/cells",
    "unit/lab/cameras",
    "unit/pictures",
    "unit/lab/test_guard",
    "unit/lab/test_motion_check",
    "unit/lab/test_swap_detection",
    "unit/log/read/test_hostile",
    "unit/log/read/test_salvage",
    "unit/log/write/test_writer",
    "unit/model",
    "unit/plant",
    "unit/replay",
    "unit/test_hostile",
    "unit/view",
)
SYSTEM = (  # wires in real time, browsers, packages that are installed, kernels compiled from
    # nothing, clusters, long runs, and pages to the last digit
    "cli/test_docs.py::test_every_example",
    "cli/test_docs.py::test_every_python_example",
    "cli/test_plugin",
    "cli/test_study_dask",
    "emulated",
    "unit/core/kernels/test_kernel_cache.py::test_compiling_and_loading_give_the_same_bits[search]",
    "unit/core/kernels/test_kernel_cache.py::test_compiling_and_loading_give_the_same_bits[ident",
    "unit/log/read/test_javascript",
    "unit/test_bench_agrees",
    "unit/test_benchmarks",
    "unit/test_hostile.py::test_the_long_run",
    "unit/view/test_film.py::test_an_mp4_lasts",
)
CELLS = re.compile(  # of the contracts: one cell a kind of promise is enough for every change
    r"contract/test_plants.py::.*\[sim, (?!undisturbed|everything|wheels, radio|dish)"
)
TURNS = ("cli/test_study", "emulated", "cli/test_docs", "plays", "cli", "")  # the longest first
APART = ("plays/", "unit/film/test_film_containers")  # which share no fixtures
LANES = 2  # plays on real wires at a time: each has deadlines to keep


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark each test's tier, and put those first that take longest."""
    places = {item: item.path.as_posix().rpartition("/tests/")[2] for item in items}
    items.sort(key=lambda item: next(i for i, t in enumerate(TURNS) if places[item].startswith(t)))
    for item in items:
        node = f"{places[item]}::{item.name}"
        if node.startswith(SYSTEM) or CELLS.search(node):
            item.add_marker(pytest.mark.system)
        if places[item].startswith(SLOW) or item.get_closest_marker("system"):
            item.add_marker(pytest.mark.slow)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: object) -> object:
    """Give the tests of a module, which share fixtures, to one process, but for those `APART`.

    xdist 3.8 passes over its own groups in pytest 9.2, and says nothing.
    """
    from xdist.scheduler import LoadScopeScheduling

    class Modules(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            place = nodeid.rpartition("tests/")[2]
            if place.startswith("emulated/"):
                return f"lane {len(nodeid) % LANES}"
            return nodeid if place.startswith(APART) else nodeid.partition("::")[0]

    config.option.loadscopereorder = False
    return Modules(config, log)
