"""Tests that simulated robots on wheels drive like the emulated robots of the lab."""

from dataclasses import replace

import numpy as np
import pytest
from testkit.plants import DIRECTIONS, driven, sim
from testkit.trials import experiment
from tetractl_emulator.m3pi.robot import EmulatedRobot, EmulatedRobots

from tetractl.core.clock import SECOND
from tetractl.lab.actuators.m3pi.broadcast import BroadcastCommand, encode_command
from tetractl.lab.cobs import Flag
from tetractl.model.wheels import Drivetrains

pytestmark = pytest.mark.long

ROBOTS = experiment().robots
LAG_S = 0.04
RADIUS_MM = 40
DRIVE = {
    "count": 1000 / 127,
    "dead_zone": 6,
    "dead_zone_error": 2,
    "gain_error": 0.1,
    "lag": LAG_S,
}


def simulated_drive():
    """A simulation that drives, stops by its watchdog, and rests; its commands and samples."""
    spec = experiment(
        plant={"drive": DRIVE, "camera_rate": 100, "truth_rate": 1000},
        wheels={"radius": RADIUS_MM, "watchdog": 0.25},
        obstacles=[],
    )
    simulated = sim(spec)
    commands, samples = driven(simulated, DIRECTIONS * 3, SECOND // 25)
    simulated.clock.sleep_until(3 * SECOND)
    samples += simulated.samples()
    return simulated, commands, samples


def emulated_fleet(true_wheels):
    """Emulated robots with these wheels at the same starts."""
    count = len(ROBOTS)
    robots = [EmulatedRobot(robot.name, i) for i, robot in enumerate(ROBOTS)]
    fleet = EmulatedRobots(
        robots, true_wheels, np.full(count, float(RADIUS_MM)), np.full(count, LAG_S)
    )
    for robot, of_spec in zip(robots, ROBOTS, strict=True):
        robot.place(*of_spec.start, of_spec.heading)
    return fleet


def broadcast_to(fleet, number, command, known_wheels):
    """Send a command by radio as the counts that the lab computes from the wheels it knows."""
    speeds = np.array([command.left, command.right])
    counts, _ = known_wheels.counts(speeds, np.zeros((2, len(ROBOTS))))
    of_robots = tuple(tuple(pair) for pair in counts.T.tolist())
    frame = encode_command(BroadcastCommand(number, Flag.RUN, of_robots))
    for robot in fleet.robots:
        robot.receive(frame)


def test_simulated_and_emulated_robots_drive_the_same_path():
    """The same counts at the same times, until the watchdogs of the simulation and of the firmware
    stop the robots: at a common time step of 1 ms, the paths differ by rounding only.
    """
    simulated, commands, samples = simulated_drive()
    trains = simulated.drive.host.drivetrains
    true_wheels = Drivetrains(
        gain=trains.true_gain,
        dead_zone=trains.true_dead_zone,
        limit=trains.limit,
        swap=np.zeros(len(ROBOTS), np.bool_),
    )
    known_wheels = replace(true_wheels, gain=trains.gain, dead_zone=trains.dead_zone)
    fleet = emulated_fleet(true_wheels)
    waiting = list(commands)
    differences = []
    for number, sample in enumerate(samples):
        now_ns = sample.observation.sampled_ns
        while waiting and waiting[0].sent_ns <= now_ns:
            command = waiting.pop(0)
            fleet.advance(command.sent_ns)
            broadcast_to(fleet, number, command, known_wheels)
        fleet.advance(now_ns)
        difference = fleet.pose.T - sample.truth.array()
        differences.append(np.abs(difference).max())
    first, late, last = (samples[k].truth.xy for k in (0, -30, -1))
    assert np.abs(last - first).max() > 50
    assert np.abs(last - late).max() < 1e-6  # stopped
    assert max(differences) < 1e-9
