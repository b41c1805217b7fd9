"""What leaves an emulated camera of poses, while its server is in trouble."""

from support.acting import act
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.optitrack.pose_camera import Exposure, Outlet

from tetractl.core.clock import SECOND


def test_a_picture_that_froze_while_the_server_was_silent_is_shown_when_it_speaks():
    """Regression: robots were said to be unseen since before the silence, though the first frame
    after it showed them as they were at its end."""
    sent = []
    acting = ActingFaults()
    silent = act(acting, "no_server")
    outlet = Outlet(acting, sent.append)
    assert outlet.send(Exposure("before", 1 * SECOND)) is None
    act(acting, "freeze")
    acting.remove(silent)
    shown = outlet.send(Exposure("after", 2 * SECOND))
    assert shown == Exposure("before", 1 * SECOND)
    assert sent == ["before"]
