"""Rigid bodies as an emulated motion-capture system shows them, read as the host reads them."""

import cmath
import math
from random import Random
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.emulator.acting import act
from tetractl_emulator.optitrack.tracked_body import (
    HEIGHT_MM,
    Asset,
    PoseNoise,
    TrackedBody,
    View,
    has_valid_pose,
)

from tetractl.lab.cameras.optitrack.natnet import Placement, UpAxis

angles = st.floats(-math.pi, math.pi)
lengths = st.floats(-2000, 2000)
each_axis = pytest.mark.parametrize("up", UpAxis)
EXACT = PoseNoise(0.0, 0.0, Random(1))
X_MM, Y_MM, HEADING = 400.0, -300.0, 0.6


def tracked(**more):
    robot = SimpleNamespace(name="green", x=X_MM, y=Y_MM, heading=HEADING)
    return TrackedBody(robot, Asset(7, "green"), **{"noise": EXACT} | more)


def read(body, view):
    """Position [mm], heading, height [mm] and tilt as the host computes them from a rigid body."""
    placement = Placement(*view.origin, view.rotation, 1000.0)
    pose = placement.pose(body, view.up)
    return complex(pose.x, pose.y), pose.heading, pose.height, pose.tilt


def check(body, position, heading, height=HEIGHT_MM, view=None):
    seen, seen_heading, seen_height, tilt = read(body, view or View())
    assert seen == pytest.approx(position, abs=1e-6)
    assert math.remainder(seen_heading - heading, math.tau) == pytest.approx(0, abs=1e-9)
    assert seen_height == pytest.approx(height)
    assert tilt == pytest.approx(0, abs=1e-6)
    assert has_valid_pose(body)


@each_axis
@given(x=lengths, y=lengths, heading=angles, ox=lengths, oy=lengths, rotation=angles)
def test_the_host_reads_the_pose_that_the_robot_has(up, x, y, heading, ox, oy, rotation):
    view = View(up, (ox, oy), rotation)
    check(view.rigid_body_at(7, x, y, heading, 60.0), complex(x, y), heading, view=view)


@each_axis
@given(grown=st.floats(0.5, 2), turned=angles, dx=lengths, dy=lengths)
def test_a_changed_picture_is_turned_about_the_origin_scaled_and_then_moved(
    up, grown, turned, dx, dy
):
    view = View(up, shift_mm=complex(dx, dy), scale=grown, turned_rad=turned)
    expected = complex(X_MM, Y_MM) * grown * cmath.exp(1j * turned) + complex(dx, dy)
    body = view.rigid_body_at(7, X_MM, Y_MM, HEADING, 60.0)
    check(body, expected, HEADING + turned, view=View(up))


def test_only_a_creeping_fault_of_the_picture_remains_and_grows():
    view = View()
    creeps = SimpleNamespace(creeps=True, by=(2.0, 1.0), scale=1.1, turn=0.1)
    jumps = SimpleNamespace(creeps=False, by=(50.0, 0.0), scale=2.0, turn=0.5)
    shown = [view.at_exposure([creeps, jumps]), view.at_exposure([creeps]), view.at_exposure([])]
    assert [picture.shift_mm for picture in shown] == [52 + 1j, 4 + 2j, 4 + 2j]
    assert [picture.scale for picture in shown] == pytest.approx([2.2, 1.21, 1.21])
    assert [picture.turned_rad for picture in shown] == pytest.approx([0.6, 0.2, 0.2])


def test_a_constant_error_moves_and_turns_a_body():
    body = tracked(shift_mm=3 - 4j, turned_rad=0.2).expose(View())
    check(body, complex(X_MM + 3, Y_MM - 4), HEADING + 0.2)


def test_an_asset_has_its_own_heading_which_the_host_adds_again():
    made = tracked()
    made.asset.heading_offset = 0.5
    check(made.expose(View()), complex(X_MM, Y_MM), HEADING - 0.5)


@pytest.mark.parametrize("axes", ["arena", "robot"])
def test_a_ghost_goes_on_with_each_frame_and_leaves_no_error(axes):
    made = tracked()
    ghost = act(made.acting, "ghost", robot="green", by=(10.0, 0.0), turn=0.01, axes=axes)
    step = 10 * (cmath.exp(1j * HEADING) if axes == "robot" else 1)
    for count in (1, 2, 3):
        check(made.expose(View()), complex(X_MM, Y_MM) + count * step, HEADING + 0.01 * count)
    made.acting.remove(ghost)
    check(made.expose(View()), complex(X_MM, Y_MM), HEADING)


def test_a_jump_is_in_the_axes_of_the_arena_and_a_slip_in_those_of_the_robot():
    made = tracked()
    act(made.acting, "jump", robot="green", by=(30.0, -20.0))
    act(made.acting, "slip", robot="green", by=(5.0, 0.0), turn=0.3)
    act(made.acting, "lifted", robot="green", height=150.0)
    act(made.acting, "jump", robot="red", by=(900.0, 0.0))
    expected = complex(X_MM + 30, Y_MM - 20) + 5 * cmath.exp(1j * HEADING)
    check(made.expose(View()), expected, HEADING + 0.3, height=150.0)


def test_a_body_that_is_not_seen_is_untracked_at_its_last_pose():
    made = tracked()
    before = made.expose(View())
    fault = act(made.acting, "untracked", robot="green")
    act(made.acting, "ghost", robot="green", by=(10.0, 0.0), turn=0.0, axes="arena")
    made.robot.x += 100
    hidden = made.expose(View())
    assert not hidden.tracking_valid
    assert (hidden.position, hidden.quaternion) == (before.position, before.quaternion)
    assert made.drift_mm == 0
    made.acting.remove(fault)
    check(made.expose(View()), complex(X_MM + 110, Y_MM), HEADING)


@pytest.mark.parametrize(("robot", "repeats"), [("green", True), (None, True), ("red", False)])
def test_a_repeated_pose_is_tracked_and_old(robot, repeats):
    made = tracked()
    before = made.expose(View())
    act(made.acting, "repeat", robot=robot)
    made.robot.x += 100
    again = made.expose(View())
    assert again.tracking_valid
    assert (again.position == before.position) == repeats


def test_a_body_may_be_in_every_third_frame_or_in_a_fraction_of_them():
    made = tracked()
    third = act(made.acting, "half_tracked", robot="green", every=3, share=0.0)
    assert [made.expose(View()).tracking_valid for _ in range(6)] == [False, False, True] * 2
    made.acting.remove(third)
    act(made.acting, "half_tracked", robot="green", every=1, share=0.25)
    seen = sum(made.expose(View()).tracking_valid for _ in range(4000))
    assert seen == pytest.approx(3000, abs=120)  # 4 standard deviations


@each_axis
@pytest.mark.parametrize("angle", [0.3, -0.8])
def test_a_tipped_body_keeps_its_heading_and_is_tilted(up, angle):
    made = tracked()
    act(made.acting, "tipped", robot="green", angle=angle)
    view = View(up)
    position, heading, _, tilt = read(made.expose(view), view)
    assert position == pytest.approx(complex(X_MM, Y_MM))
    assert heading == pytest.approx(HEADING)
    assert tilt == pytest.approx(abs(angle))


@pytest.mark.parametrize("kind", ["nan", "bad_quaternion"])
def test_a_broken_pose_is_not_one(kind):
    made = tracked()
    act(made.acting, kind, robot="red")
    assert has_valid_pose(made.expose(View()))
    act(made.acting, kind, robot="green")
    body = made.expose(View())
    assert body.tracking_valid
    assert not has_valid_pose(body)


def test_noise_has_the_deviations_that_are_stated():
    made = tracked(noise=PoseNoise(2.0, 0.05, Random(4)))
    seen = [read(made.expose(View()), View()) for _ in range(2000)]
    errors_mm = [part for p, *_ in seen for part in (p.real - X_MM, p.imag - Y_MM)]
    assert math.sqrt(sum(e * e for e in errors_mm) / 4000) == pytest.approx(2.0, rel=0.06)
    turns = [heading - HEADING for _, heading, *_ in seen]
    assert math.sqrt(sum(e * e for e in turns) / 2000) == pytest.approx(0.05, rel=0.08)
