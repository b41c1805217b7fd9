"""Tests that names and addresses in texts get aliases, and nothing else does."""

import pytest

from tetractl.log.bundle.aliases import Aliases

INNOCENT = [
    "natnet: 4.1.0.0",
    "Motive 3.1.0.1 on 127.0.0.1:1510, multicast 239.255.42.99, broadcast 255.255.255.255",
    "bind to 0.0.0.0 and ::",
    "started 2026-11-30T16:20:51.000+00:00, at 16:20:51",
    "topic /green/cmd_vel of geometry_msgs::msg::dds_::Twist_",
    "tetractl.core.errors, lab.limits.wheel_error=0.2, three_m3pi_lab.yaml",
    "robots: [green, blue, red], colour '#00ff7f'",
    "port: /dev/ttyUSB0, baud: 57600, id 0013",
    "hash b0e477d7592e02a5c1a337c5297f90ec0fa297cab4dfe269b6d42d60a15e1fc3",
    "file:///tmp/a.xml and ros2://0/green/cmd_vel and http://localhost:8080/stream",
    "git 28092c5d, code d7d0ac3f48db, 12:30, 1.5.2, 192.168",
    "name: '@NAME@', 5 @ 20 Hz",
]


@pytest.mark.parametrize("text", INNOCENT)
def test_what_names_nobody_stays(text):
    assert Aliases().alias_text(text) == text


@pytest.mark.parametrize(
    ("text", "alias"),
    [
        ("address: 192.168.1.5", "address: 192.0.2.1"),
        ("udp://10.0.0.7:9001.", "udp://192.0.2.1:9001."),
        ("fe80::1ff:fe23:4567:890a at 8", "2001:db8::1 at 8"),
        ("a0:b1:c2:d3:e4:f5", "00:00:5e:00:53:01"),
        ("A0-B1-C2-D3-E4-F5", "00-00-5e-00-53-01"),
        ("radio 0013A200 40B12345", "radio 0013A20000000001"),
        ("ask ada@uni.edu", "ask person-1@example.org"),
        ("rtsp://admin:secret@cam7.uni.edu/live", "rtsp://host-1.example/live"),
        ("/home/ada/lab.yaml", "/home/user/lab.yaml"),
        (r"C:\Users\Ada\lab.yaml", r"C:\Users\user\lab.yaml"),
    ],
)
def test_an_address_gets_an_alias(text, alias):
    assert Aliases().alias_text(text) == alias


def test_an_address_has_the_same_alias_in_all_texts():
    aliases = Aliases()
    first = aliases.alias_text("192.168.1.5 and 192.168.1.6")
    assert first == "192.0.2.1 and 192.0.2.2"
    assert aliases.alias_text("192.168.1.6") == "192.0.2.2"
    assert aliases.counts == {"addresses": 2}


def test_given_names_are_replaced_wherever_they_occur():
    aliases = Aliases(["Ada", "Ada Lovelace"])
    assert aliases.alias_text("ada lovelace's lab, ADA_lab") == "removed-1's lab, removed-2_lab"
    assert aliases.mask_payload(b"\x00Ada\x01ada") == b"\x00xxx\x01xxx"


def test_a_computers_name_is_replaced_unless_it_is_an_ordinary_word():
    aliases = Aliases()
    for name in ("lab", "ada-laptop", ""):
        aliases.add_host_name(name)
    assert aliases.alias_text("lab: on ada-laptop") == "lab: on removed-1"
