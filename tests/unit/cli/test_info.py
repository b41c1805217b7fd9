"""Tests of the lines of `info`: what stands in each section, and which sections there are."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from testkit.batches import result

from tetractl.cli import info as module
from tetractl.cli.info import LINE_LENGTH_MAX, _format_estimate, _format_lines, info
from tetractl.core.errors import Exit
from tetractl.core.motion_estimate import Estimate
from tetractl.core.plan import Outcome
from tetractl.log.read.overview import ChannelCount, Overview
from tetractl.log.read.trial_log import Damage, Event


def overview(**fields):
    made = {
        "log": "a.mcap",
        "size": 1234,
        "chunks": 2,
        "run": {"name": "s", "unit": "mm", "robots": '["one", "two"]'},
        "result": result([1.25, 2.5], outcome=Outcome.ARRIVED, reason=""),
        "events": (Event(1.5, "info", "started"),),
        "estimate": None,
        "estimate_step": None,
        "channels": (
            ChannelCount("/poses", "Frame", 120, 60.0, 999),
            ChannelCount("/run", "Run", 1, None, 9),
        ),
        "attachments": {"spec.yaml": 77},
        "host": {"cpu": "x"},
        "provenance": {"tetractl": "1"},
        "digest": "d1",
        "stated_digest": "d1",
        "damage": None,
    }
    return Overview(**(made | fields))


def sections(**fields):
    """The lines of each section by its title."""
    first, *lines = _format_lines(overview(**fields))
    assert first == "a.mcap: 1234 bytes, 2 chunks"
    found = {}
    title = ""
    for before, line in zip(["", *lines], lines, strict=False):
        if not line:
            continue
        if before == "" and not line.startswith(" "):
            title = line
            found[title] = []
        else:
            found[title].append(line.strip())
    return found


def test_an_intact_log_has_these_sections():
    assert list(sections()) == [
        "run", "result", "events", "channels", "attachments", "host", "provenance",
        "content digest",
    ]  # fmt: skip


def test_a_section_without_lines_is_left_out():
    found = sections(events=(), attachments={}, host={})
    assert not {"events", "attachments", "host"} & set(found)


def test_the_result_in_the_unit_of_the_log():
    made = result(
        [1.25, 2.5],
        outcome=Outcome.ABORTED,
        reason="it fell",
        duration_s=6.254,
        solve_ns=(1_000_000, 12_340_000, 3_000_000),
        deadline_misses=4,
    )
    rows = dict(line.split("  ", 1) for line in sections(result=made)["result"])
    assert {key: value.strip() for key, value in rows.items()} == {
        "outcome": "aborted",
        "reason": "it fell",
        "steps": "31",
        "duration": "6.25 s",
        "total error": "3.8 mm",
        "robot errors": "1.2, 2.5 mm",
        "entered obstacle": "no",
        "longest solve": "12.3 ms",
        "deadline misses": "4",
    }


def test_a_result_without_a_reason_or_searches_has_a_dash():
    lines = sections(result=result([1.0], reason="", solve_ns=()))["result"]
    assert "reason            -" in lines
    assert "longest solve     -" in lines


def test_a_log_that_breaks_off_has_no_result():
    (line,) = sections(result=None)["result"]
    assert line.startswith("outcome  none, because the log breaks off")


def test_channels_have_their_rates_if_they_have_any():
    poses, run = sections()["channels"]
    assert poses.split() == ["/poses", "Frame", "120", "messages", "60.0", "Hz"]
    assert run.split() == ["/run", "Run", "1", "messages"]


@pytest.mark.parametrize(
    ("stated", "lines"),
    [
        ("d1", ["stated and computed  d1"]),
        ("d2", ["stated    d2", "computed  d1"]),
        (None, ["computed  d1"]),
    ],
)
def test_a_stated_digest_that_differs_is_shown_beside_the_computed_one(stated, lines):
    assert sections(stated_digest=stated)["content digest"] == lines


def test_damage_is_told_with_what_is_lost():
    damage = Damage(("torn",), ("all after 2 s",))
    assert sections(damage=damage)["damage"] == ["torn", "lost: all after 2 s"]


ESTIMATE = Estimate(
    a=np.array([4.0, 2.0]),
    a_std=np.array([0.12, 0.05]),
    speed=np.array([100.0, 50.0]),
    speed_std=np.array([2.0, 0.5]),
)


def estimated(**fields):
    return sections(estimate=replace(ESTIMATE, **fields), estimate_step=7)["estimate at step 7"]


def test_an_estimate_has_a_line_for_each_robot():
    assert estimated() == [
        "one  a 4.00 +- 0.12 rad/s, speed 100.0 +- 2.0 mm/s",
        "two  a 2.000 +- 0.050 rad/s, speed 50.00 +- 0.50 mm/s",
    ]


def test_what_is_estimated_besides_is_added():
    small = np.array([0.01, 0.01])
    lines = estimated(
        heading_bias=np.array([0.1, -0.2]), heading_bias_std=small,
        lag=np.array([0.15, 0.25]), lag_std=small, dead_time=0.08, dead_time_std=0.01,
    )  # fmt: skip
    assert "heading bias 0.100 +- 0.010 rad, lag 0.150 +- 0.010 s" in lines[0]
    assert "heading bias -0.200 +- 0.010 rad, lag 0.250 +- 0.010 s" in lines[1]
    assert lines[2].split() == ["dead", "time", "0.080", "+-", "0.010", "s"]


def test_what_the_model_does_not_fit_is_named():
    misfit = np.array([[0.1, 0.1, 1.2], [1.3, 0.1, 0.1]])
    found = "\n".join(estimated(misfit=misfit))
    assert "the model does not fit" in found
    assert "heading of one" in found
    assert "along-track motion of two" in found
    assert "does not fit" not in "\n".join(estimated(misfit=np.zeros((2, 3))))


@pytest.mark.parametrize(
    ("value", "std", "text"),
    [
        (1.2345, 0.123, "1.23 +- 0.12"),
        (1.2345, 0.0123, "1.234 +- 0.012"),
        (123.45, 12.0, "123 +- 12"),
        (123.45, 340.0, "123 +- 340"),
        (1.5, 0.0, "1.500 +- 0.000"),
        (1.5, math.inf, "1.500 +- inf"),
        (1.5, 1e-12, "1.500000000 +- 0.000000000"),
    ],
)
def test_a_value_has_two_digits_of_its_deviation(value, std, text):
    assert _format_estimate(value, std) == text


@pytest.mark.parametrize(("damage", "code"), [(None, 0), (Damage(("torn",), ()), 1)])
def test_a_damaged_log_fails(monkeypatch, capsys, tmp_path, damage, code):
    monkeypatch.setattr(module, "find_log", lambda log: log)
    long = overview(damage=damage, host={"cpu": "x" * 1000})
    monkeypatch.setattr("tetractl.log.read.overview.overview", lambda log: long)
    assert info(tmp_path) == Exit(code)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) == LINE_LENGTH_MAX
    assert info(tmp_path, as_json=True) == Exit(code)
    assert json.loads(capsys.readouterr().out)["host"]["cpu"] == "x" * 1000
