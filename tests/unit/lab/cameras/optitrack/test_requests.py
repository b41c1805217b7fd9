"""Tests of what the client asks a server, and how often."""

from collections import Counter
from types import SimpleNamespace

import pytest

from tetractl.core.clock import SECOND
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.camera import REQUEST_INTERVAL_NS, OptitrackCamera
from tetractl.lab.cameras.optitrack.stream import UNITS_SETTING, UP_AXIS_SETTING

KNOWN = {
    "info": "server",
    "up_axis": "y",
    "unit_mm": 1000.0,
    "model": "bodies",
    "models_changed": False,
    "is_changing": False,
    "list_missing_bodies": lambda: False,
    "clock_sync": None,
}


def camera(unicast=False, pinned=None, **stream):
    """A camera without sockets, of whose server this is known."""
    made = object.__new__(OptitrackCamera)
    made.stream = SimpleNamespace(**KNOWN | stream)
    made._requested_version = pinned
    made._unicast = unicast
    made._request_counts = Counter()
    made._due_ns_by_request = {}
    return made


def asked(made, now=0):
    return {name: (wait_ns, message) for name, wait_ns, message in made._list_requests(now)}


def test_once_all_is_known_nothing_is_asked():
    assert asked(camera()) == {}


def test_a_server_is_asked_to_answer_first():
    connect = asked(camera(info=None, up_axis=None, model=None, unicast=True))
    assert list(connect) == ["connect"]
    assert connect["connect"] == (REQUEST_INTERVAL_NS, natnet.Connect(natnet.NEWEST, False))
    pinned = natnet.Version(3, 1)
    assert asked(camera(info=None, pinned=pinned))["connect"][1] == natnet.Connect(pinned, True)


def test_what_is_missing_is_asked_for():
    assert asked(camera(up_axis=None)) == {
        "up": (REQUEST_INTERVAL_NS, natnet.NatNetRequest(UP_AXIS_SETTING))
    }
    assert asked(camera(unit_mm=None)) == {
        "unit": (REQUEST_INTERVAL_NS, natnet.NatNetRequest(UNITS_SETTING))
    }
    assert list(asked(camera(up_axis=None, unit_mm=None, model=None))) == ["up", "models"]
    assert list(asked(camera(unicast=True))) == ["alive"]


def test_a_server_that_ignores_the_question_for_its_unit_is_asked_four_times():
    made = camera(unit_mm=None)
    for count, asks in ((0, True), (3, True), (4, False), (9, False)):
        made._request_counts["unit"] = count
        assert ("unit" in asked(made)) == asks


@pytest.mark.parametrize("reason", ["models_changed", "is_changing", "list_missing_bodies"])
def test_the_time_between_questions_for_models_doubles_up_to_eight_seconds(reason):
    made = camera(**{reason: (lambda: True) if reason == "list_missing_bodies" else True})
    waits_s = []
    for count in range(8):
        made._request_counts["models"] = count
        waits_s.append(asked(made)["models"][0] / SECOND)
    assert waits_s == [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 8.0, 8.0]
    made.stream = SimpleNamespace(**KNOWN)
    made._due_ns_by_request["models"] = 99 * SECOND
    assert asked(made, now=SECOND) == {}
    assert made._request_counts["models"] == 0  # it starts again
    assert made._due_ns_by_request["models"] == SECOND + REQUEST_INTERVAL_NS


def test_the_time_is_asked_for_often_at_first_and_then_twice_a_second():
    made = camera(clock_sync="clock")
    assert asked(made, 7) == {"echo": (SECOND // 50, natnet.EchoRequest(7))}
    made._request_counts["echo"] = 1000
    assert asked(made, 8) == {"echo": (SECOND // 2, natnet.EchoRequest(8))}
