"""Tests that a server's answers are accepted only on request, and only once."""

import pytest

from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.stream import OpenRequests

SERVER = natnet.ServerInfo("Motive", natnet.Version(4, 1), clock_hz=10_000_000, data_port=1511)
BODIES = natnet.ModelDef((("green", 11),))
REQUEST_BODIES = natnet.BareMessage(natnet.MessageKind.REQUEST_MODELDEF)
FRAME = natnet.NatNetFrame(1, (), 0, 0)
PAIRS = [
    (natnet.Connect(), SERVER),
    (REQUEST_BODIES, BODIES),
    (natnet.EchoRequest(client=5), natnet.EchoResponse(client=5, server=99)),
]


@pytest.mark.parametrize(("request_", "answer"), PAIRS)
def test_each_request_allows_one_answer(request_, answer):
    requests = OpenRequests()
    assert not requests.close(answer)
    requests.add(request_)
    requests.add(request_)
    assert requests.close(answer)
    assert requests.close(answer)
    assert not requests.close(answer)


def test_an_answer_does_not_close_a_request_of_another_kind():
    requests = OpenRequests()
    requests.add(natnet.Connect())
    requests.add(REQUEST_BODIES)
    assert requests.close(BODIES)
    assert requests.close(SERVER)


def test_what_a_server_sends_by_itself_needs_no_request():
    requests = OpenRequests()
    assert requests.close(FRAME)
    assert requests.close(FRAME)


def test_of_requests_that_are_text_the_last_is_taken_once():
    requests = OpenRequests()
    requests.add(natnet.NatNetRequest("UpAxis"))
    requests.add(natnet.NatNetRequest("UnitsToMillimeters"))
    assert requests.take_text() == "UnitsToMillimeters"
    assert requests.take_text() is None
