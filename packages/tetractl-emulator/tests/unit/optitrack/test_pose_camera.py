"""What leaves an emulated camera of poses, while its server is in trouble."""

from tetractl_emulator.optitrack.pose_camera import Exposure, Outlet
from tetractl_emulator.optitrack.scripted import Trouble

from tetractl.core.clock import SECOND


def test_a_picture_that_froze_while_the_server_was_silent_is_shown_when_it_speaks():
    """Regression: robots were said to be unseen since before the silence, though the first frame
    after it showed them as they were at its end."""
    sent = []
    trouble = Trouble(silent=True)
    outlet = Outlet(trouble, sent.append)
    assert outlet.send(Exposure("before", 1 * SECOND)) is None
    trouble.frozen = True
    trouble.silent = False
    shown = outlet.send(Exposure("after", 2 * SECOND))
    assert shown == Exposure("before", 1 * SECOND)
    assert sent == ["before"]
