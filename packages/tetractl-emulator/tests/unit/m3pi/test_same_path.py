"""Simulated robots on wheels against the emulated robots of the lab."""

from dataclasses import replace

import numpy as np
import pytest
from support.plants import DIRECTIONS, driven, sim
from support.trials import experiment
from tetractl_emulator.m3pi.robot import EmulatedRobot, EmulatedRobots

from tetractl.core.clock import SECOND
from tetractl.lab.actuators.m3pi.broadcast import BroadcastCommand, encode_command
from tetractl.lab.cobs import Flag
from tetractl.model.wheels import Drivetrains
from tetractl.plant import wheel_kernel

pytestmark = pytest.mark.long

COUNT = 1000 / 127
ROBOTS = experiment().robots


def test_simulated_and_emulated_robots_drive_the_same_path():
    """The same counts at the same times, until the watchdogs of the simulation and of the firmware
    stop the robots: at a common time step of 1 ms, the paths differ by rounding only.
    """
    drive = {"count": COUNT, "dead_zone": 6, "dead_zone_error": 2, "gain_error": 0.1, "lag": 0.04}
    rates = {"camera_rate": 100, "truth_rate": 1000}
    wheels = {"radius": 40, "watchdog": 0.25}
    spec = experiment(plant={"drive": drive, **rates}, wheels=wheels, obstacles=[])
    simulated = sim(spec)
    commands, samples = driven(simulated, DIRECTIONS * 3, SECOND // 25)
    simulated.clock.sleep_until(3 * SECOND)
    samples += simulated.samples()
    robots = [EmulatedRobot(robot.name, i) for i, robot in enumerate(ROBOTS)]
    trains = simulated.drive.host.trains
    limit = trains[wheel_kernel.COUNT_LIMIT, 0]
    gain = trains[wheel_kernel.TRUE_GAIN]
    zone = trains[wheel_kernel.TRUE_DEAD_ZONE]
    true = Drivetrains(gain, zone, limit, np.zeros(3, np.bool_))
    fleet = EmulatedRobots(robots, true, np.full(3, 40.0), np.full(3, 0.04))
    for robot, given in zip(robots, ROBOTS, strict=True):
        robot.place(*given.start, given.heading)
    known_gain = trains[wheel_kernel.GAIN]
    known_zone = trains[wheel_kernel.DEAD_ZONE]
    known = replace(true, gain=known_gain, dead_zone=known_zone)
    sent = iter(commands)
    command = next(sent)
    differences = []
    for number, sample in enumerate(samples):
        while command is not None and command.sent_ns <= sample.observation.sampled_ns:
            fleet.advance(command.sent_ns)
            counts, _ = known.counts(np.array([command.left, command.right]), np.zeros((2, 3)))
            frame = BroadcastCommand(number, Flag.RUN, tuple(map(tuple, counts.T.tolist())))
            for robot in robots:
                robot.hear(encode_command(frame))
            command = next(sent, None)
        fleet.advance(sample.observation.sampled_ns)
        differences.append(np.abs(np.array(fleet.now().places) - sample.truth.array()).max())
    assert np.abs(samples[-1].truth.xy - samples[0].truth.xy).max() > 50
    assert np.abs(samples[-1].truth.xy - samples[-30].truth.xy).max() < 1e-6  # stopped
    assert max(differences) < 1e-9
