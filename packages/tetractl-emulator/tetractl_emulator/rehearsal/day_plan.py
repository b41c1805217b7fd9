"""Samples the plan of a randomised test run: faults, true properties of devices, and settings."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from random import Random
from typing import Any

import numpy as np

from tetractl.core.poses import Poses
from tetractl.core.setup import Setup
from tetractl.spec.lab_section import LabSection
from tetractl_emulator.fault_rows import ENDLESS_STRENGTH, FaultRow, RandomChoices, length_scale
from tetractl_emulator.script import DeviceClasses

START_FRACTION = 0.16
"""Maximum distance of a robot from its start, as a fraction of the limit `start_mm`."""
SPAN_S = 11.0
"""Maximum time from the first command that moves robots to the begin of a fault [s]."""
CHOICE_S = 5.0
"""Time that is added to SPAN_S if trials choose their cells first [s]."""
BLIND_FRACTION = 0.1
"""Fraction of the test runs in which robots on wheels drive without feedback.

They drive until a limit of the guard stops them.
"""
BLIND_S = 15
"""Duration of driving without feedback, in which each robot reaches an edge of the arena [s]."""
FACING_FRACTION = 0.5
"""Fraction of the runs without feedback in which two robots start face to face."""
FACING_DISTANCES = (2.0, 3.0)
"""Range of the distance of these two robots, as a multiple of the limit `separation_mm`.

The two robots meet while one of them turns around.
"""
SHORT_FRACTION = 0.15
"""Fraction of the test runs whose trial ends while robots drive.

The time limit of such a trial is in the range SHORT_S [s].
"""
SHORT_S = (2.0, 8.0)
NOT_IN_SCRIPT = ("kind", "right")  # keys of a sampled fault that a script must not contain


@dataclass(frozen=True, slots=True)
class DayPlan:
    """The plan of a randomised test run (a *day*).

    Attributes:
        seed: Seed of the trial.
        emulation: True properties of the devices.
        faults: The faults of the script, each with its variant's name ("kind") and the pattern of
            reasons that name it correctly ("right").
        settings: Settings that replace values of the spec.
    """

    seed: int
    emulation: Mapping[str, Any]
    faults: Sequence[Mapping[str, Any]]
    settings: Sequence[str] = ()

    @property
    def faults_in_order(self) -> list[Mapping[str, Any]]:
        """The faults of this test run, sorted by the times at which they begin.

        Faults that begin at the same time keep their order.
        """
        return sorted(self.faults, key=lambda fault: fault["at"])

    def script(self) -> dict[str, Any]:
        """Return the plan as a script for an emulated lab.

        Its faults are in the order of their times.
        """
        sampled = self.faults_in_order
        faults = [
            {key: value for key, value in fault.items() if key not in NOT_IN_SCRIPT}
            for fault in sampled
        ]
        summary = ", ".join(dict.fromkeys(fault["kind"] for fault in sampled)) or "no fault"
        runner = {"runner": {"set": [*self.settings]}} if self.settings else {}
        return {"about": summary, "emulation": dict(self.emulation), "faults": faults, **runner}


def rows_of(lab: LabSection, setup: Setup) -> list[FaultRow]:
    """Return the variants of all faults that a lab can have.

    Faults that concern a second robot are left out for a single robot.
    """
    devices = DeviceClasses.of_types(lab.camera.type, lab.actuator.type)
    rows = [row for kind in devices.faults.values() for row in kind.rows]
    return [row for row in rows if "other" not in row.fields or len(setup.names) > 1]


def plan_of_day(
    seed: int,
    day: int,
    lab: LabSection,
    setup: Setup,
    chosen: bool = False,
    with_faults: bool = True,
) -> DayPlan:
    """Sample the plan of a randomised test run.

    It depends only on the arguments.

    Args:
        seed: Seed of all test runs.
        day: Index of this test run.
        lab: The lab's section of the spec.
        setup: The constants of the experiment.
        chosen: Whether trials choose their robots among the cells in a dish.
        with_faults: Whether to include faults.
    """
    # the order of the draws is part of the result: another one would change all days
    random = Random(f"{seed}-{day}")
    devices = DeviceClasses.of_types(lab.camera.type, lab.actuator.type)
    faults: list[dict[str, Any]] = []
    if with_faults:
        names = devices.actuator.choosable if chosen else setup.names
        span_s = SPAN_S + CHOICE_S if chosen else SPAN_S
        scale = length_scale(lab, setup)
        faults = faults_of_day(random, names, rows_of(lab, setup), span_s, scale)
    emulation: dict[str, Any] = {}
    for name, device in (("camera", devices.camera), ("actuator", devices.actuator)):
        if hasattr(device, "world_of_day"):
            emulation[name] = device.world_of_day(random, lab, setup)
    trial_seed = random.randrange(2**31)
    starts = setup.starts
    settings: list[str] = []
    if with_faults and lab.actuator.type != "field":
        settings, starts = _settings_of_day(random, lab, setup)
    if not chosen:
        offset_max = START_FRACTION * lab.limits.start_mm / 1000 / setup.metres
        emulation["robots"] = _sample_starts(random, setup.names, starts, offset_max)
    return DayPlan(trial_seed, emulation, faults, settings)


def _settings_of_day(random: Random, lab: LabSection, setup: Setup) -> tuple[list[str], Poses]:
    """Sample whether the trial is short, steered without feedback, or as in the spec.

    Returns:
        Settings that replace values of the spec, and the poses at which the robots start.
    """
    chance = random.random()
    if chance < SHORT_FRACTION:
        return [f"controller.time_limit={random.uniform(*SHORT_S):.1f}"], setup.starts
    if chance <= 1 - BLIND_FRACTION:
        return [], setup.starts
    starts = setup.starts
    separation = lab.limits.separation_mm / 1000 / setup.metres
    first_rad = random.uniform(-math.pi, math.pi)
    if random.random() < FACING_FRACTION:
        starts, first_rad = _face_to_face(random, setup, separation)
    settings = [_open_loop_setting(random, setup.period_s, first_rad)]
    for i, (x, y, heading) in enumerate(starts.array().tolist()):
        settings += [f"robots.{i}.start={[x, y]}", f"robots.{i}.heading={heading}"]
    return settings, starts


def _open_loop_setting(random: Random, period_s: float, first_rad: float) -> str:
    """Generate the setting of an open-loop controller that holds each direction for about a second.

    Args:
        random: The random generator.
        period_s: Control period [s].
        first_rad: The first direction [rad]. The others are random.
    """
    periods_per_direction = round(1 / period_s)
    sampled_rad = [first_rad, *(random.uniform(-math.pi, math.pi) for _ in range(BLIND_S - 1))]
    directions = [
        round(direction, 2) for direction in sampled_rad for _ in range(periods_per_direction)
    ]
    return f"controller={{type: sequence, period: {period_s}, directions: {directions}}}"


def _face_to_face(random: Random, setup: Setup, separation: float) -> tuple[Poses, float]:
    """Generate starts at which two robots face each other.

    The first robot is on its own start, and faces the middle of the arena. If its heading is sent
    as the direction, it drives ahead, and the other robot drives towards it until it has turned
    around. If the other robot would be in an obstacle, another pair is tried. If there is no such
    pair, the starts are those of the spec.

    Returns:
        The starts, and the heading of the first robot [rad].
    """
    starts = setup.starts.array()
    pairs = list(permutations(range(len(starts)), 2))
    middle_x = setup.arena.left + setup.arena.width / 2
    middle_y = setup.arena.bottom + setup.arena.height / 2
    for first_robot, second_robot in random.sample(pairs, len(pairs)):
        x, y, _ = starts[first_robot]
        facing_rad = math.atan2(middle_y - y, middle_x - x)
        distance = random.uniform(*FACING_DISTANCES) * separation
        second_x = x + distance * math.cos(facing_rad)
        second_y = y + distance * math.sin(facing_rad)
        if all(shape.distance(second_x, second_y) > setup.body_radius for shape in setup.obstacles):
            starts[first_robot, 2] = facing_rad
            starts[second_robot] = (second_x, second_y, facing_rad - math.pi)
            return Poses.from_array(np.round(starts, 4)), facing_rad
    return setup.starts, 0.0


def faults_of_day(
    random: Random,
    names: Sequence[str],
    rows: Sequence[FaultRow],
    span_s: float = SPAN_S,
    scale: float = 1.0,
) -> list[dict[str, Any]]:
    """Sample the faults of a randomised test run, in the form of a script.

    A third of the test runs have one fault, and the others have two to six. Each fault also
    contains the name of its variant as `kind`, and the pattern of reasons that name it correctly as
    `right`.

    Args:
        random: The random generator.
        names: The robots.
        rows: The variants of faults.
        span_s: Time in which faults begin [s].
        scale: Factor for lengths; see `length_scale`.
    """
    count = 1 if random.random() < 1 / 3 else random.randint(2, 6)
    sampled_rows = random.choices(rows, [row.weight for row in rows], k=count)
    return [_sample_fault(row, random, names, span_s, scale) for row in sampled_rows]


def _sample_fault(
    row: FaultRow, random: Random, names: Sequence[str], span_s: float, scale: float
) -> dict[str, Any]:
    """Sample one fault of a variant: its fields, when it begins, and how long it lasts.

    It begins in the first second after the start, at a time up to `span_s` [s], or within 0.5 s
    after the stop. Without the field `for`, it has no end.
    """
    choices = RandomChoices(random, random.sample(names, len(names)), random.random(), scale)
    fault: dict[str, Any] = {"kind": row.name, "right": row.reason_pattern, "fault": row.fault}
    for key, field_value in row.fields.items():
        fault[key] = field_value(choices) if callable(field_value) else field_value
    chance = random.random()
    if chance < row.start_fraction:
        fault |= {"since": "start", "at": round(random.uniform(0, 1), 3)}
    elif chance > 1 - row.stop_fraction:
        fault |= {"since": "stop", "at": round(random.uniform(0, 0.5), 3)}
    else:
        fault["at"] = round(random.uniform(0, span_s), 3)
    if not row.at_once and "for" not in fault and choices.strength < ENDLESS_STRENGTH:
        fault["for"] = round(0.02 * 800 ** random.random(), 3)  # from 20 ms to 16 s
    return fault


def _sample_starts(
    random: Random, names: Sequence[str], starts: Poses, offset_max: float
) -> list[dict[str, Any]]:
    """Sample true starts of the robots near their starts in the spec.

    Positions differ by at most `offset_max` [length unit], and headings by at most 0.05 rad.
    """
    placements = []
    for name, (x, y, heading) in zip(names, starts.array().tolist(), strict=True):
        offset = random.uniform(0, offset_max)
        angle = random.uniform(-math.pi, math.pi)
        start_x = x + offset * math.cos(angle)
        start_y = y + offset * math.sin(angle)
        heading_start = round(heading + random.uniform(-0.05, 0.05), 4)
        placements.append(
            {
                "name": name,
                "start": [round(start_x, 2), round(start_y, 2)],
                "heading": heading_start,
            }
        )
    return placements
