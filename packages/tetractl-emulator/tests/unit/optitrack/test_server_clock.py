"""Tests that a camera server whose clock is set or runs wrongly is noticed and named."""

import random
from dataclasses import dataclass

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tetractl_emulator.optitrack.natnet_server import pack_answer

from tetractl.core.clock import SECOND
from tetractl.lab.cameras.optitrack import natnet
from tetractl.lab.cameras.optitrack.natnet import Placement, UpAxis
from tetractl.lab.cameras.optitrack.section import TrackedRobot
from tetractl.lab.cameras.optitrack.stream import ClockSync, NatNetStream

pytestmark = pytest.mark.slow

V41 = natnet.Version(4, 1)
HZ = 10_000_000
BURST = 20  # as the client asks
BURST_NS = SECOND // 50
ECHO_NS = SECOND // 2
MS = 1_000_000
CAMERA_NS = SECOND // 120
STEP_NS = SECOND // 2000


@dataclass(frozen=True)
class OnItsWay:
    """A datagram that arrives at a host time [ns]."""

    arrival_ns: int
    datagram: bytes


class Server:
    """Stands for a camera server that answers echoes and sends frames to a real `NatNetStream`.

    Its clock against the host's: `ahead` [ns] and `rate` may change at any time. Frames may be
    dated otherwise: `ticks_of_frame` returns the ticks of one by its number and host time [ns].
    """

    def __init__(self, seed=1, delay_ms=(0.1, 0.5)):
        self.now = 0
        self.stream = NatNetStream(
            (TrackedRobot(name="robot", body=7),), Placement(0, 0, 0, 1000.0), up=UpAxis.Z
        )
        self.stream.record_request(natnet.Connect())
        self.stream.feed(pack_answer(natnet.ServerInfo("Motive", V41, HZ, 1511)), 0)
        self.ahead = 5 * 3600 * SECOND
        self.rate = 1.0
        self.ticks_of_frame = lambda number, host_ns: self.ticks(host_ns)
        self._chance = random.Random(seed)
        self._delay_ms = delay_ms
        self._rate_since = 0
        self._echoes = 0
        self._frames = 0
        self._next_echo = 0
        self._next_frame = 0
        self._coming = []  # by their arrival

    def ticks(self, host_ns):
        """The server's ticks at a host time."""
        gained = (self.rate - 1) * (host_ns - self._rate_since)
        return round((host_ns + self.ahead + gained) * HZ / SECOND)

    def run_at(self, rate):
        """Change the rate from now on, without a jump."""
        self.ahead += round((self.rate - 1) * (self.now - self._rate_since))
        self.rate = rate
        self._rate_since = self.now

    def until(self, seconds):
        """Let time go on to `seconds`; return when a frame first had a fault [s], None for none."""
        while self.now < seconds * SECOND:
            self.now += STEP_NS
            if self.now >= self._next_echo:
                self._echo()
            if self.now >= self._next_frame:
                self._frame()
            while self._coming and self._coming[0].arrival_ns <= self.now:
                arrived = self._coming.pop(0)
                self.stream.feed(arrived.datagram, self.now)
            if self.stream.newest is not None and self.stream.newest.fault:
                return self.now / SECOND
        return None

    def _delay_ns(self):
        return round(self._chance.uniform(*self._delay_ms) * 1e6)

    def _echo(self):
        self._echoes += 1
        self._next_echo = self.now + (BURST_NS if self._echoes < BURST else ECHO_NS)
        self.stream.record_request(natnet.EchoRequest(self.now))
        answered_ns = self.now + self._delay_ns()
        answer = natnet.EchoResponse(self.now, self.ticks(answered_ns))
        self._send(answered_ns + self._delay_ns(), answer)

    def _frame(self):
        self._frames += 1
        self._next_frame += CAMERA_NS
        body = natnet.RigidBody(7, (1.0, 1.0, 0.1), (0.0, 0.0, 0.0, 1.0), True)
        exposure = self.ticks_of_frame(self._frames, self.now)
        frame = natnet.NatNetFrame(self._frames, (body,), exposure=exposure)
        jitter_ms = self._chance.uniform(0.1, 1.5)  # frames keep their order, echoes need not
        self._send(self.now + round((5.0 + jitter_ms) * 1e6), frame)

    def _send(self, arrival_ns, message):
        self._coming.append(OnItsWay(arrival_ns, pack_answer(message, V41)))
        self._coming.sort(key=lambda datagram: datagram.arrival_ns)


@pytest.mark.parametrize(("after_s", "jump_s"), [(10.1, 0.05), (10.3, 5.0), (40.2, 0.2)])
def test_a_clock_that_jumps_forward_is_a_fault_within_a_tenth_of_a_second(jump_s, after_s):
    server = Server()
    assert server.until(after_s) is None
    server.ahead += round(jump_s * SECOND)
    assert server.until(after_s + 2) - after_s < 0.1
    fault = server.stream.newest.fault
    assert "frames were exposed" in fault
    assert "after reception: the clock was set, or runs at a wrong rate" in fault
    assert server.stream.counts.unread == 4  # dropped before the fault is certain


@pytest.mark.parametrize("rate", [1.02, 1.005, 0.995, 0.98])
def test_a_clock_that_runs_wrongly_is_named_within_two_echoes(rate):
    server = Server()
    assert server.until(10.1) is None
    server.run_at(rate)
    assert server.until(12) - 10.1 < 2 * ECHO_NS / SECOND + 0.1
    assert ("gained" if rate > 1 else "lost") in server.stream.newest.fault


def test_single_frames_of_a_wrong_time_are_dropped_and_are_no_fault():
    """Of the 240 frames of 2 s each tenth is dated a second late."""
    server = Server()

    def ticks_of_frame(number, host_ns):
        return server.ticks(host_ns + SECOND if number % 10 == 0 else host_ns)

    server.ticks_of_frame = ticks_of_frame
    assert server.until(2) is None
    assert server.stream.counts.unread == 24


@pytest.mark.long
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    ("drift", "delay_ms"), [(1e-4, (0.1, 0.5)), (-9e-4, (0.1, 0.5)), (5e-4, (0.1, 150.0))]
)
def test_a_good_clock_is_no_fault_however_late_echoes_are(drift, delay_ms, seed):
    server = Server(seed, delay_ms)
    server.run_at(1 + drift)
    assert server.until(50) is None
    assert server.stream.counts.unread == 0


delays_ns = st.integers(0, 3 * MS)
round_trips = st.lists(st.tuples(delays_ns, delays_ns), min_size=1)


@given(
    hz=st.sampled_from([1_000_000, 2_441_406, 10_000_000]),
    offset_s=st.integers(0, 10**6),
    delays=round_trips,
    exposure=st.integers(0, 10 * SECOND),
)
def test_the_error_is_at_most_half_the_round_trip_it_tells(hz, offset_s, delays, exposure):
    sync = ClockSync(hz)

    def ticks(host_ns):
        return (host_ns + offset_s * SECOND) * hz // SECOND

    for i, (way_out, way_back) in enumerate(delays):
        sent = i * 10 * MS
        sync.add(sent, sent + way_out + way_back, ticks(sent + way_out))
    error_ns = abs(sync.to_host(ticks(exposure)) - exposure)
    rounding_ns = 2 * SECOND / hz + 2
    assert error_ns <= sync.round_trip_ns / 2 + rounding_ns


def test_a_drift_is_found_and_undone():
    sync = ClockSync(10_000_000)
    drift = 50e-6

    def ticks(host_ns):
        return round((host_ns * (1 + drift) + SECOND) / 100)

    for i in range(120):
        sent = i * SECOND // 2
        sync.add(sent, sent + 200_000 + i % 7 * 50_000, ticks(sent + 100_000))
    assert abs(sync.drift - drift) < 5e-6
    later = 65 * SECOND
    assert abs(sync.to_host(ticks(later)) - later) < 200_000


def test_frames_of_another_clock_than_the_echoes_are_named():
    """Regression: every frame was dropped as damaged, and `lab check` found nothing wrong."""
    server = Server()
    server.ticks_of_frame = lambda number, host_ns: 0
    assert server.until(2) < 0.5
    assert "s before reception: the clock was set" in server.stream.newest.fault
