"""What leaves an emulated camera of poses, while its server is in trouble."""

from support.acting import act
from tetractl_emulator.faults import ActingFaults
from tetractl_emulator.loop import Timeline
from tetractl_emulator.optitrack.pose_camera import PoseCamera
from tetractl_emulator.optitrack.tracked_body import View
from tetractl_emulator.pose_stream import Shot
from tetractl_emulator.sides import Options, Stage

from tetractl.core.clock import SECOND


class Kept(PoseCamera):
    """A camera above nothing, which keeps the numbers of what it sends."""

    def __init__(self, acting):
        timeline = Timeline(lambda until_ns: None)
        unheard = [lambda *_: None] * 3
        stage = Stage(None, None, timeline, Options(), None, *unheard, acting=acting)
        super().__init__(stage, [], rate=100.0, latency_s=0.002, view=View())
        self.sent = []

    def _shot(self, number, exposed_ns, bodies):
        return Shot(number, exposed_ns, bodies)

    def _stream(self, frame, now_ns):
        self.sent.append(frame.number)


def test_a_picture_that_froze_while_the_server_was_silent_is_shown_when_it_speaks():
    """Regression: robots were said to be unseen since before the silence, though the first frame
    after it showed them as they were at its end."""
    acting = ActingFaults()
    silent = act(acting, "no_server")
    camera = Kept(acting)
    camera.begin()
    camera.timeline.run_to(SECOND // 20)
    assert camera.sent == []
    act(acting, "freeze")
    acting.remove(silent)
    camera.timeline.run_to(SECOND // 10)
    assert camera.sent == [5] * len(camera.sent) != []
