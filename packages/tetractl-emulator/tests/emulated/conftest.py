"""Pytest fixtures for tests on real connections: compiled code, and a computer that is not too
busy.
"""

import os

import pytest
from testkit.emulator.lab_processes import SMALL, SPEC
from testkit.lateness import lateness

from tetractl.control.methods.build import warm_up
from tetractl.spec.load import load_spec

LATE_S = 0.05  # half of the shortest tolerance: a host as late as that spoils a play
LOAD = 2.0  # on each core: then another process is late, whatever this one is
HOST = pytest.StashKey()


@pytest.fixture(autouse=True, scope="session")
def compiled_controller():
    """Compile the controller before the plays: a minute of it would count as one that hangs."""
    warm_up(load_spec(SPEC, SMALL).experiment, print)


@pytest.fixture(autouse=True)
def watched_host(request):
    """Watch how late this host wakes a thread, from here to the end of the play."""
    with lateness() as request.node.stash[HOST]:
        yield


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Skip what failed while the host was late: it stops the robots then, as it should."""
    report = yield
    host = item.stash.get(HOST, None)
    load = os.getloadavg()[0]
    cores = os.cpu_count() or 1
    late = host is not None and host.most_s >= LATE_S
    if report.failed and host is not None and (late or load > LOAD * cores):
        report.outcome = "skipped"
        why = (
            f"Skipped: this host was {host.most_s:.2f} s late, of load {load:.0f} on {cores} cores"
        )
        report.longrepr = (str(item.path), item.location[1] or 0, why)
    return report
