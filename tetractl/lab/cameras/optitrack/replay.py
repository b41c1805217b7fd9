"""A recorded wire fed into a NatNet stream again."""

from collections.abc import Iterable
from contextlib import suppress

from tetractl.lab.cameras.optitrack.stream import Stream
from tetractl.lab.cameras.optitrack.wire import parse
from tetractl.lab.errors import WireError
from tetractl.lab.recorder import Passage


def replay_cameras(passages: Iterable[Passage], stream: Stream) -> None:
    """Feed what came from the cameras into a stream, as it was fed live."""
    for passage in passages:
        if passage.wire != "natnet":
            continue
        if passage.received:
            stream.feed(passage.data, passage.t_ns)
            continue
        with suppress(WireError):  # a file may claim that we sent anything
            stream.asked(parse(passage.data))
