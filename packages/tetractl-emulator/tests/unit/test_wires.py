"""Tests of the sockets of an emulated lab."""

import pytest
from tetractl_emulator.wires import bound_udp

from tetractl.core.errors import TetractlError


def test_a_socket_listens_only_at_the_address_it_was_given_and_never_waits():
    with bound_udp("127.0.0.1", 0) as bound:
        assert bound.getsockname()[0] == "127.0.0.1"
        with pytest.raises(BlockingIOError):
            bound.recv(1)


def test_a_port_in_use_is_one_line_with_a_remedy():
    with bound_udp("127.0.0.1", 0) as bound:
        port = bound.getsockname()[1]
        with pytest.raises(TetractlError, match=rf"cannot open UDP 127\.0\.0\.1:{port}") as caught:
            bound_udp("127.0.0.1", port)
    assert "--command-port" in caught.value.hint
