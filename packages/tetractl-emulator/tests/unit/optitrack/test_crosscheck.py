"""Tests that the public client `natnet` reads our packets in the same way as we do."""

import pytest
from testkit.emulator.natnet_samples import every_version, full_frame

from tetractl.lab.cameras.optitrack.wire import HEADER, parse_datagram

pytest.importorskip("natnet", reason="the PyPI package natnet is not installed")

from natnet.data_frame import DataFrame
from natnet.packet_buffer import PacketBuffer
from natnet.version import Version as TheirVersion

pytestmark = pytest.mark.slow


@every_version
def test_frames_are_read_alike(version):
    packed = full_frame(version)
    ours = parse_datagram(packed, version)
    theirs = DataFrame.read_from_buffer(PacketBuffer(packed[HEADER.size :]), TheirVersion(*version))
    assert theirs.prefix.frame_number == ours.number
    assert [
        (body.id_num, body.pos, body.rot, body.tracking_valid) for body in theirs.rigid_bodies
    ] == [(body.id, body.position, body.quaternion, body.tracking_valid) for body in ours.bodies]
    assert len(theirs.labeled_markers) == 2
    if version >= (2, 11):
        assert theirs.devices[0].channel_arrays == ((3.0,),)
    if version >= (4, 1):
        assert len(theirs.assets[0].markers) == 2
    if (3, 0) <= version < (4, 1):  # it does not know the suffixes before and after
        assert theirs.suffix.stamp_camera_mid_exposure == ours.exposure
        assert theirs.suffix.param == ours.params
