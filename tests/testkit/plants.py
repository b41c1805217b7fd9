"""All plants by name, each with a clock, for the contract tests."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml

from testkit.labs import CAMERA_HZ, fake_lab
from testkit.trials import experiment
from tetractl.core.clock import SECOND, Clock, VirtualClock
from tetractl.core.commands import Steer
from tetractl.core.poses import Floats
from tetractl.core.protocols import Plant
from tetractl.plant.sim_section import SimSection
from tetractl.plant.simulation import SimPlant
from tetractl.spec.experiment import Experiment

PERIOD = SECOND // 5
DIRECTIONS = np.random.default_rng(5).uniform(-np.pi, np.pi, 12).tolist()
PAIR = [  # two that hardly turn, along +x
    {"name": "one", "start": [900, 800], "target": [1700, 500], "a": 1e-9, "speed": 100},
    {"name": "two", "start": [900, 900], "target": [1700, 900], "a": 1e-9, "speed": 50},
]


@dataclass(frozen=True)
class Rig:
    """One plant under test and what the suite needs to drive it."""

    plant: Plant
    clock: Clock
    spec: Experiment
    true_to: float  # how far a robot's measured position may be from the truth, if known [mm]
    kind: str
    camera_rate_hz: float
    disturbed: bool  # whether the seed makes a difference


def sim(spec: Experiment, seed: int = 1, clock: Clock | None = None) -> SimPlant:
    """A simulated plant, seeded, on a clock of its own unless one is given."""
    section = spec.plant
    assert isinstance(section, SimSection)
    return SimPlant(section, spec.setup, clock or VirtualClock(), np.random.SeedSequence(seed))


def driven(simulated: SimPlant, directions=DIRECTIONS, period: int = PERIOD):
    """Open, steer once a period; return all commands, and all samples up to the last one's end."""
    simulated.open()
    commands = []
    samples = []
    for k, direction in enumerate(directions):
        commands.append(simulated.send(Steer(direction)))
        simulated.clock.sleep_until((k + 1) * period)
        samples += simulated.samples()
        commands += simulated.events()
    return commands, samples


def truths(samples) -> Floats:
    """Return the true poses (M, N, 3)."""
    return np.array([sample.truth.array() for sample in samples])


def sim_rig(seed: int, **plant: Any) -> Rig:
    spec = experiment(plant=plant, wheels={"radius": 40})
    clock = VirtualClock()
    noise = plant.get("measurement_noise", {}).get("position", 0.0)
    disturbed = bool(plant.keys() - {"motion", "camera_rate", "truth_rate", "dead_time"})
    disturbed &= plant != DISTURBANCES["wheels"]
    rate = plant.get("camera_rate", 120.0)
    return Rig(sim(spec, seed, clock), clock, spec, 8 * noise, "sim", rate, disturbed)


def lab_rig(seed: int) -> Rig:
    spec = experiment(wheels={"radius": 40})
    lab = fake_lab(spec.setup)
    return Rig(lab.plant, lab.clock, spec, 0.0, "lab", CAMERA_HZ, disturbed=False)


DISTURBANCES: dict[str, dict[str, Any]] = yaml.safe_load("""
undisturbed: {}
euler: {motion: euler}
measurement noise: {measurement_noise: {position: 2.0, heading: 0.02}}
heading noise: {heading_noise: 0.2}
dead time: {dead_time: 0.13}
lost commands: {lost_commands: 0.3}
wrong a: {a_error: 0.2}
wrong speed: {speed_error: 0.2}
slow camera: {camera_rate: 7.0, truth_rate: 100.0}
everything: {measurement_noise: {position: 2.0, heading: 0.02}, heading_noise: 0.2,
  dead_time: 0.1, lost_commands: 0.3, a_error: 0.2, speed_error: 0.2}
hurting:
  disturbances:
    - {type: wander, a: 0.1, speed: 0.05}
    - {type: battery, speed: 0.1, over: 2}
    - {type: sticking, every: 0.3, duration: 0.1}
    - {type: silent-radio, duration: 0.1, between: [0, 1]}
    - {type: radio, spread: 0.05}
wheels: {drive: {rate: 40}}
wheels, radio and camera:
  camera_rate: 100.0
  measurement_noise: {position: 1.0, heading: 0.01}
  heading_noise: 0.05
  a_error: 0.1
  drive: {rate: 40, lead: 0.007, count: 7.874, dead_zone: 6, dead_zone_error: 1, gain_error: 0.02,
    radius_error: 0.02, lag: 0.04}
  disturbances:
    - {type: camera-latency, mean: 0.006, deviation: 0.001, late_share: 0.01}
    - {type: planning-time, least: 0.002, spread: 0.004}
    - {type: radio, delay: 0.007, jitter: 0.001, loss: 0.1}
dish:
  camera_rate: 30.0
  heading_noise: 0.05
  disturbances:
    - {type: wobble, radius: 8, frequency: 1.5}
    - {type: flow, speed: 10}
    - {type: heading-drift, rate: 0.1}
""")
RIGS: dict[str, Callable[[int], Rig]] = {
    f"sim, {name}": lambda seed, plant=plant: sim_rig(seed, **plant)
    for name, plant in DISTURBANCES.items()
} | {"lab, fake devices": lab_rig}
"""Each makes a rig from a seed. A further plant joins the contract by an entry here."""
