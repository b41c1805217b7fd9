"""Tests of the fields of robots on two wheels in a spec: what they refuse, what they mean."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.trials import experiment

from tetractl.core.errors import AbortError
from tetractl.lab import cobs
from tetractl.lab.actuators.m3pi.broadcast import BroadcastCommand, encode_command
from tetractl.lab.actuators.m3pi.section import FRAME_BYTES, WHEELS_BYTES, M3piSection
from tetractl.lab.actuators.own_section import OwnSection
from tetractl.lab.actuators.twist.section import TwistSection
from tetractl.lab.actuators.wheeled_section import Found, FoundWheel
from tetractl.lab.actuators.xbee.api_frames import BROADCAST, encode

NAMES = ("green", "blue", "red")
SETUP = replace(experiment(wheels={"radius": 40}).setup, watchdog_s=0.25)
WITHOUT_WHEELS = replace(SETUP, wheel_radius=None)
FOUND = Found(
    heading_offset=0.1,
    radius_mm=44.0,
    left=FoundWheel(1.8, 3, False),
    right=FoundWheel(2.2, 5, False),
    swap=False,
)


def entries(*changes):
    rows = [{"name": name} for name in NAMES]
    for row, change in zip(rows, changes, strict=False):
        row.update(change)
    return rows


def twist(*changes, **fields):
    section = {"type": "twist", "port": "/dev/null", "robots": entries(*changes)}
    return TwistSection.model_validate(section | fields)


def m3pi(*changes, **fields):
    section = {"type": "m3pi-xbee", "port": "/dev/null", "robots": entries(*changes)}
    return M3piSection.model_validate(section | fields)


class OwnRobotsSection(OwnSection):
    type: str = "own"


def own(*changes, **fields):
    rows = entries(*changes)
    for i, row in enumerate(rows):
        row.setdefault("address", f"udp://127.0.0.1:{9801 + i}")
    return OwnRobotsSection.model_validate({"robots": rows} | fields)


def fields_of(problems):
    return [loc for loc, _ in problems]


@pytest.mark.parametrize("make", [twist, m3pi, own])
def test_an_honest_section_has_no_problem(make):
    assert list(make().contradictions(SETUP)) == []
    with_radii = make(*[{"radius_mm": 30.0}] * 3)
    assert list(with_radii.contradictions(WITHOUT_WHEELS)) == []


@pytest.mark.parametrize("make", [twist, m3pi, own])
def test_a_robot_without_a_radius_is_a_problem_where_the_spec_has_none_either(make):
    section = make({"radius_mm": 30.0}, {}, {"radius_mm": 30.0})
    assert fields_of(section.contradictions(WITHOUT_WHEELS)) == [("robots", 1, "radius_mm")]


@pytest.mark.parametrize("make", [twist, m3pi])
def test_robots_have_different_numbers_which_are_by_default_their_places(make):
    section = make({"index": 5}, {}, {})
    assert [section.index(name) for name in NAMES] == [5, 1, 2]
    assert list(section.contradictions(SETUP)) == []
    twice = make({"index": 0}, {"index": 2}, {})
    assert [twice.index(name) for name in NAMES] == [0, 2, 2]
    assert len(list(twice.contradictions(SETUP))) == 1


@pytest.mark.parametrize("make", [twist, own])
def test_the_maximum_speed_may_be_the_speed_of_the_fastest_robot_and_not_less(make):
    assert SETUP.speed.max() == 200
    assert list(make(speed_max_mm_s=200).contradictions(SETUP)) == []
    problems = fields_of(make(speed_max_mm_s=199).contradictions(SETUP))
    assert problems == [("speed_max_mm_s",)]
    in_metres = replace(SETUP, speed=SETUP.speed / 1000, metres=1.0)
    assert list(make(speed_max_mm_s=200).contradictions(in_metres)) == []


def test_an_address_on_the_network_needs_a_host_and_a_port():
    assert list(twist(port="udp://10.0.0.255:9800").contradictions(SETUP)) == []
    assert fields_of(twist(port="udp://10.0.0.255").contradictions(SETUP)) == [("port",)]
    one = twist({}, {"port": "udp://nowhere"}, {"port": "udp://10.0.0.7:9800"})
    assert fields_of(one.contradictions(SETUP)) == [("robots", 1, "port")]
    mine = own({}, {"address": "udp://nowhere"}, {"address": "/dev/rfcomm0"})
    assert fields_of(mine.contradictions(SETUP)) == [("robots", 1, "address")]


def test_two_own_robots_have_two_addresses():
    twice = own({"address": "/dev/rfcomm0"}, {"address": "/dev/rfcomm0"})
    assert len(list(twice.contradictions(SETUP))) == 1


@pytest.mark.parametrize(
    ("watchdog_s", "refused"), [(0.25, False), (0.2, False), (0.2501, True), (np.inf, True)]
)
def test_the_spec_may_not_expect_a_longer_watchdog_than_own_robots_have(watchdog_s, refused):
    setup = replace(SETUP, watchdog_s=watchdog_s)
    assert fields_of(own().contradictions(setup)) == ([()] if refused else [])


@pytest.mark.parametrize(
    ("baud", "robots", "hz"),
    [
        (57_600, 3, 60),
        (57_600, 15, 60),
        (57_600, 16, 40),  # 60 Hz would keep the port busy for 51 % of the time
        (57_600, 28, 20),
        (115_200, 32, 60),
        (19_200, 3, 40),
        (9_600, 3, 20),
        (9_600, 32, 20),
    ],
)
def test_m3pi_robots_get_as_many_commands_as_their_radio_has_room_for(baud, robots, hz):
    rows = [{"name": f"r{i}"} for i in range(robots)]
    section = M3piSection(type="m3pi-xbee", port="/dev/null", baud=baud, robots=rows)
    assert section.commands_hz == hz
    assert section.model_copy(update={"rate": 120.0}).commands_hz == 120


def test_an_index_that_is_not_the_next_one_makes_commands_longer():
    assert m3pi(baud=19_200).commands_hz == 40
    assert m3pi({}, {}, {"index": 3}, baud=19_200).commands_hz == 20


@pytest.mark.parametrize("robots", [1, 3, 32])
def test_a_command_has_as_many_bytes_on_the_port_as_assumed(robots):
    command = BroadcastCommand(7, cobs.Flag.RUN, ((5, -5),) * robots)
    sent = encode(BROADCAST + encode_command(command))
    assert len(sent) - sent.count(0x7D) == FRAME_BYTES + WHEELS_BYTES * robots


@pytest.mark.parametrize(("rate", "refused"), [(12.0, False), (11.9, True), (10.0, True)])
def test_own_robots_get_three_commands_within_their_watchdog(rate, refused):
    problems = fields_of(own(rate=rate).contradictions(SETUP))
    assert problems == ([("rate",)] if refused else [])


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_dead_zone_must_leave_counts_that_drive(side):
    below = m3pi({"limit": 31, side: {"dead_zone": 30}})
    assert list(below.contradictions(SETUP)) == []
    for limit in (30, 29):
        at = m3pi({}, {"limit": limit, side: {"dead_zone": 30}})
        assert fields_of(at.contradictions(SETUP)) == [("robots", 1, side, "dead_zone")]


@pytest.mark.parametrize("limit", [1, 64, 127])
def test_outputs_of_a_calibration_are_parts_of_full_speed(limit):
    unit, most = twist(speed_max_mm_s=381).outputs("green", limit)
    assert (unit, most) == (3.0, 3 * limit)
    assert twist(speed_max_mm_s=100).outputs("green", 64)[1] == 50, "no more than allowed"
    assert m3pi({"limit": 90}).outputs("green", limit) == (1.0, min(limit, 90))
    assert m3pi({"limit": 90}).outputs("blue", limit) == (1.0, limit)


def test_what_a_calibration_has_measured_is_written_to_the_fields():
    fields = {"radius_mm": 44.0, "left_gain": 1.8, "right_gain": 2.2}
    assert twist().measured(FOUND) == own().measured(FOUND) == fields
    written = m3pi().measured(replace(FOUND, swap=True))
    assert written == {
        "radius_mm": 44.0,
        "left": {"gain_mm": 1.8, "dead_zone": 3, "invert": False},
        "right": {"gain_mm": 2.2, "dead_zone": 5, "invert": False},
        "swap": True,
    }
    assert str(FOUND).endswith("right wheel 2.20 mm/s per count above 5")
    assert str(replace(FOUND, swap=True)).endswith("swapped")


def test_ports_are_named_once_each_and_a_robot_without_one_has_the_common_one():
    section = twist({"port": "a"}, {}, {"port": "a"}, port="b")
    assert section.ports() == ["a", "b"]
    assert [section.port_of(name) for name in NAMES] == ["a", "b", "a"]
    assert section.bounds()["robots"] == "a, b, 40 lines per second"


def test_a_serial_port_must_exist_and_a_network_address_need_not():
    twist().require_port()
    m3pi().require_port()
    twist({"port": "udp://10.0.0.7:9800"}).require_port()
    for missing in (m3pi(port="/dev/none"), twist({}, {"port": "/dev/none"})):
        with pytest.raises(AbortError, match="/dev/none: there is no such port"):
            missing.require_port()


def test_the_highest_count_of_any_robot_is_shown():
    assert m3pi({"limit": 20}, {"limit": 90}, {"limit": 50}).bounds()["wheel counts"] == (
        "at most 90 of 127"
    )
