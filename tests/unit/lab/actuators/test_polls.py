"""Tests of which replies to a poll are accepted, for twist and m3pi robots."""

from collections import deque

from testkit.device_replies import reply_line

from tetractl.core.clock import VirtualClock
from tetractl.lab.actuators.twist.line_ports import TwistLink
from tetractl.lab.actuators.twist.lines import decode_command
from tetractl.lab.actuators.twist.section import TwistSection
from tetractl.lab.actuators.wheel_commands import Reply, Status, poll_robots

HONEST_MV = 4800
FORGED_MV = 9999


def reply_of(index, sequence, battery_mv=HONEST_MV):
    return Reply(index, sequence, Status.RUNNING, battery_mv, 1, 0)


class RobotsPort:
    """A port in memory: `answer(sequence)` gives the replies that come at once to a line."""

    failure = None

    def __init__(self, heard, answer):
        self.heard = heard
        self.answer = answer

    def open(self, alone=True):
        pass

    def settle(self):
        pass

    def write(self, data):
        for reply in self.answer(decode_command(data[:-1]).sequence):
            self.heard(reply_line(reply), 0)
        return 0


def linked(port_of, answers, clock=None):
    """Return a link to robots 0 to N - 1 at ports, each with its `answers`, and the ports."""
    ports = {}

    def make(name, baud, device, clock, heard, hint):
        ports[name] = RobotsPort(heard, answers[name])
        return ports[name]

    names = [f"robot {i}" for i in range(len(port_of))]
    robots = [{"name": name, "port": port} for name, port in zip(names, port_of, strict=True)]
    fields = {"type": "twist", "port": "air", "robots": robots}
    link = TwistLink(TwistSection.model_validate(fields), names, clock or VirtualClock(), make)
    link.open()
    return link, ports


def test_a_robot_that_replies_to_the_poll_is_believed():
    link, _ = linked(["air"], {"air": lambda sequence: [reply_of(0, sequence)]})
    assert link.poll(1.0) == [reply_of(0, 1)]


def test_a_reply_that_waited_before_the_poll_is_dropped():
    """Regression: a robot that was off counted as present, by a reply sent 5 s before."""
    link, ports = linked(["air"], {"air": lambda sequence: []})
    ports["air"].heard(reply_line(reply_of(0, 1)), 0)  # with the sequence of the poll to come
    assert link.poll(1.0) == [None]


def test_a_reply_with_the_sequence_of_another_command_is_not_believed():
    """Regression: "9999 mV" of a sender that had not heard the poll was printed."""
    forged = {"air": lambda sequence: [reply_of(0, (sequence + 7) % 256, FORGED_MV)]}
    link, _ = linked(["air"], forged)
    assert link.poll(1.0) == [None]


def test_a_robot_is_believed_at_its_own_port_alone():
    replies_of_two = {
        "a": lambda sequence: [reply_of(0, sequence)],
        "b": lambda sequence: [reply_of(0, sequence, FORGED_MV), reply_of(1, sequence)],
    }
    link, _ = linked(["a", "b"], replies_of_two)
    assert link.poll(1.0) == [reply_of(0, 1), reply_of(1, 1)]


def test_a_late_reply_to_the_try_before_still_counts():
    """Of two polls of one question, the first one's answer says as much of the robot."""
    clock = VirtualClock()
    coming = deque([[], [reply_of(0, 1)]])
    sequences = iter((1, 2, 3, 4, 5))

    class LateRobot:
        failure = None

        def send_poll(self):
            return next(sequences), clock.now()

        def receive_replies(self, timeout_s):
            clock.sleep_until(clock.now() + round(timeout_s * 1e9))
            return coming.popleft()

    assert poll_robots(LateRobot(), [0], clock, 1.0, 20) == [reply_of(0, 1)]


def test_the_number_of_the_first_poll_cannot_be_foretold():
    """Regression: it was always 1."""
    asked = []
    clock = VirtualClock()
    clock.sleep_until(123_456_789)
    link, _ = linked(["air"], {"air": lambda sequence: asked.append(sequence) or []}, clock)
    link.poll(0.1)
    assert asked == [(123_456_789 + 1) % 256]
