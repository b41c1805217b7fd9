"""Whether a robot is said to have stood though it was sent commands."""

from dataclasses import replace

import numpy as np
import pytest

from tetractl.replay.identification.standing import stands_of
from tetractl.replay.identification.tracks import Track

DRIVE_S = 120.0
FRAMES_S = np.arange(0.0, DRIVE_S, 0.05)
SENT_S = np.arange(0.0, DRIVE_S, 0.2)
DEAD_TIME_S = 0.1
STUCK_S = (40.0, 60.0)
NOISE_MM = 0.5
NOISE_RAD = 0.01


def is_between(times, between_s):
    return (times >= between_s[0]) & (times < between_s[1])


def driven(speed_mm_s=180.0, turn_rate=0.5, stuck_s=STUCK_S):
    """A robot that turns to and fro as it drives, but not while it is stuck."""
    random = np.random.default_rng(4)
    goes = ~is_between(FRAMES_S, stuck_s)
    heading = np.cumsum(0.05 * turn_rate * np.sign(np.sin(0.4 * FRAMES_S)) * goes)
    way = 0.05 * speed_mm_s * goes * np.exp(1j * heading)
    place = np.cumsum(way)
    poses = np.column_stack([place.real, place.imag, heading])
    poses += random.normal(size=poses.shape) * (NOISE_MM, NOISE_MM, NOISE_RAD)
    return Track(
        source="p.csv",
        origin="CSV",
        unit="mm",
        names=("r1",),
        time=FRAMES_S,
        poses=poses[:, None],
        valid=np.ones((len(FRAMES_S), 1), dtype=bool),
        sent=SENT_S,
        u=np.sin(0.4 * SENT_S),
        until=DRIVE_S,
    )


def with_twists(track, speed_mm_s=180.0, turn_rate=0.5):
    """The same of a robot that is sent speeds and turning rates."""
    twists = np.column_stack(
        [np.full(len(SENT_S), speed_mm_s), turn_rate * np.sign(np.sin(0.4 * SENT_S))]
    )
    return replace(track, u=np.full(len(SENT_S), np.nan), twists=twists[:, None])


def sent_0(track, part=slice(None)):
    """Speed and turning rate, or a part of them, are 0 while it stands."""
    twists = track.twists.copy()
    twists[is_between(SENT_S, STUCK_S), :, part] = 0.0
    return replace(track, twists=twists)


STUCK = {
    "directions": driven(),
    "speeds": with_twists(driven()),
    "slow": driven(speed_mm_s=6.0),
    "sent turns on the spot": sent_0(with_twists(driven(), turn_rate=0.5), 0),
    "robots of a clock of its own": replace(driven(), time=FRAMES_S + 1e9, sent=SENT_S + 1e9),
}


@pytest.mark.parametrize("name", STUCK)
def test_a_robot_that_is_stuck_is_named_with_its_time(name):
    """Regression: stuck for 20 of 120 s, it had wide intervals and no sentence."""
    track = STUCK[name]
    track = replace(track, until=float(track.sent[-1]))
    (stood,) = stands_of([track], 0, DEAD_TIME_S)
    assert stood.begin_s == pytest.approx(STUCK_S[0], abs=1.0)
    assert stood.end_s == pytest.approx(STUCK_S[1], abs=1.0)
    assert str(stood).startswith("r1 stood from ")


def sent_nothing(track):
    """Nothing is sent while it stands."""
    kept = ~is_between(SENT_S, STUCK_S)
    twists = track.twists[kept] if track.twists.size else track.twists
    return replace(track, sent=track.sent[kept], u=track.u[kept], twists=twists)


def not_tracked(track):
    return replace(track, valid=track.valid & ~is_between(FRAMES_S, STUCK_S)[:, None])


NEVER_S = (0.0, 0.0)
DRIVING = {
    "a pause": sent_nothing(driven()),
    "a pause of speeds": sent_nothing(with_twists(driven())),
    "not tracked": not_tracked(driven()),
    "slow": driven(speed_mm_s=2.0, stuck_s=NEVER_S),
    "slow, speeds": with_twists(driven(speed_mm_s=2.0, stuck_s=NEVER_S), speed_mm_s=2.0),
    "it drives as it is sent": driven(turn_rate=0.0, stuck_s=NEVER_S),
    "speed 0 is sent": sent_0(with_twists(driven())),
    "it turns on the spot": with_twists(driven(speed_mm_s=0.0, stuck_s=NEVER_S), speed_mm_s=0.0),
    "it stops for 2 s": driven(stuck_s=(40.0, 42.0)),
    "not seen": replace(driven(), valid=np.zeros((len(FRAMES_S), 1), dtype=bool)),
    "one direction": replace(driven(), sent=SENT_S[:1], u=SENT_S[:1]),
}


@pytest.mark.parametrize("name", DRIVING)
def test_a_robot_that_does_as_it_is_sent_is_not_said_to_stand(name):
    assert stands_of([DRIVING[name]], 0, DEAD_TIME_S) == ()
