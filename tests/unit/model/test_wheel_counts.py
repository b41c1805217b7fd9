import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tetractl.model.wheels import STOP, Drivetrain, Residue, Wheel, speeds_of_counts, wheel_counts

wheels = st.builds(Wheel, st.floats(4.0, 12.0), st.integers(0, 20), st.booleans())
drivetrains = st.builds(Drivetrain, wheels, wheels, st.booleans(), st.integers(21, 127))
halves = st.floats(-0.5, 0.5)
residues = st.builds(Residue, halves, halves)
speeds = st.floats(-2000.0, 2000.0)
finite = st.floats(allow_nan=False, allow_infinity=False)


@given(speeds, speeds, drivetrains)
def test_the_mean_of_what_is_sent_is_what_was_wished(left, right, drivetrain):
    scale = saturation(left, right, drivetrain)
    residue = Residue()
    sums = [0.0, 0.0]
    steps = 64
    for _ in range(steps):
        counts, residue = wheel_counts(left, right, drivetrain, residue)
        for side, speed in enumerate(speeds_of_counts(counts, drivetrain)):
            sums[side] += speed
    for total, wish, wheel in zip(
        sums, (left, right), (drivetrain.left, drivetrain.right), strict=True
    ):
        assert abs(total / steps - wish * scale) <= wheel.gain * 0.51 / steps + 1e-9


def saturation(left, right, drivetrain):
    """Return what both speeds are scaled by, found from each wheel's top speed."""
    tops = [
        wheel.gain * (drivetrain.limit - wheel.dead_zone)
        for wheel in (drivetrain.left, drivetrain.right)
    ]
    return min(
        [1.0] + [top / abs(speed) for top, speed in zip(tops, (left, right), strict=True) if speed]
    )


@given(finite, finite, drivetrains, residues)
def test_counts_never_leave_the_limits(left, right, drivetrain, residue):
    counts, after = wheel_counts(left, right, drivetrain, residue)
    assert max(map(abs, counts)) <= drivetrain.limit
    assert all(isinstance(count, int) for count in counts)
    assert abs(after.left) <= 0.5
    assert abs(after.right) <= 0.5
    for speed, wish in zip(speeds_of_counts(counts, drivetrain), (left, right), strict=True):
        assert speed == 0 or (speed > 0) == (wish > 0)


@given(drivetrains, residues, st.sampled_from([0.0, -0.0]))
def test_stop_is_exactly_zero_whatever_is_owed(drivetrain, residue, zero):
    assert wheel_counts(zero, 0.0, drivetrain, residue) == (STOP, Residue())
    assert speeds_of_counts(STOP, drivetrain) == (0.0, 0.0)


@given(speeds, drivetrains, residues)
def test_a_wheel_wished_to_stand_stands(speed, drivetrain, residue):
    counts, after = wheel_counts(speed, 0.0, drivetrain, residue)
    assert speeds_of_counts(counts, drivetrain)[1] == 0.0
    assert counts[0 if drivetrain.swap else 1] == 0
    assert speed == 0 or after.right == residue.right


@given(speeds, speeds, drivetrains, residues)
def test_nothing_is_sent_inside_the_dead_zone(left, right, drivetrain, residue):
    counts, _ = wheel_counts(left, right, drivetrain, residue)
    first, second = counts[::-1] if drivetrain.swap else counts
    assert first == 0 or abs(first) > drivetrain.left.dead_zone
    assert second == 0 or abs(second) > drivetrain.right.dead_zone


def test_swap_and_invert():
    plain = Wheel(gain=10.0)
    turned = Wheel(gain=10.0, invert=True)
    for drivetrain, sent in (
        (Drivetrain(plain, plain), (10, 20)),
        (Drivetrain(plain, plain, swap=True), (20, 10)),
        (Drivetrain(turned, plain), (-10, 20)),
        (Drivetrain(turned, plain, swap=True), (20, -10)),
        (Drivetrain(Wheel(10.0, dead_zone=8), plain), (18, 20)),
        (Drivetrain(plain, plain, limit=10), (5, 10)),
    ):
        assert wheel_counts(100.0, 200.0, drivetrain, Residue())[0] == sent
    assert speeds_of_counts((18, 20), Drivetrain(Wheel(10.0, dead_zone=8), plain)) == (100.0, 200.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_speeds_that_are_not_finite_are_refused(bad):
    for pair in ((bad, 1.0), (1.0, bad), (bad, bad), (bad, 0.0)):
        with pytest.raises(ValueError):
            wheel_counts(*pair, Drivetrain(), Residue())


@pytest.mark.parametrize(
    "make",
    [
        lambda: Wheel(gain=0.0),
        lambda: Wheel(gain=math.nan),
        lambda: Wheel(dead_zone=127),
        lambda: Wheel(dead_zone=-1),
        lambda: Drivetrain(limit=128),
        lambda: Drivetrain(limit=0),
        lambda: Drivetrain(Wheel(dead_zone=30), limit=30),
    ],
)
def test_settings_that_cannot_drive_are_refused(make):
    with pytest.raises(ValueError):
        make()
