"""Runs the same trials on the simulated bench and in the emulated lab, to compare them.

Both use one controller at 20 Hz. It is given the dead time, and neither identifies the robots nor
plans detours, so that it cannot hide differences. The bench takes its latencies, radio, packet
loss, counts, lag, gains, radii, start errors and planning times from the same distributions as the
emulated lab. The emulated camera has no errors and loses nothing, and the emulated wheels do not
slip. Therefore the bench also has no such errors.
"""

import json
from collections.abc import Callable, Mapping
from functools import cache

import numpy as np

import tetractl
from testkit.emulator.virtual_lab import Busy, VirtualLab, virtual_lab
from testkit.paths import ROOT
from testkit.recorder import Recorder
from tetractl import TrialLog
from tetractl.core.trial import SIMULATED_START_NS, PlantInfo, TrialRecords
from tetractl.plant.disturbances.radio import PlanningTimeSection, RadioSection
from tetractl.plant.disturbances.robots import StartErrorSection
from tetractl.plant.sim_section import SimSection
from tetractl.run.checked_controller import build_controller
from tetractl.run.control_loop import Trial
from tetractl.run.interrupt import Interrupt
from tetractl.run.spec_trial import trial_seeds
from tetractl.spec.load import load_spec
from tetractl.spec.loaded_spec import LoadedSpec, create_start

LAB = ROOT / "experiments" / "three_m3pi_lab.yaml"
PLAIN = (
    "type: mpc, time_limit: 20.05, estimate: false, "
    "collision: {margin: 50, adaptive: false, stop_before_collision: false}"
)
BENCH = ROOT / "experiments" / "three_m3pi_bench.yaml"


@cache
def bench() -> SimSection:
    """The bench's plant."""
    plant = load_spec(BENCH).experiment.plant
    assert isinstance(plant, SimSection)
    return plant


def part(kind):
    """Return the bench's disturbance of a kind."""
    return next(
        disturbance for disturbance in bench().disturbances if isinstance(disturbance, kind)
    )


@cache
def lab_spec(*sets: str) -> LoadedSpec:
    """The lab's spec, whose dead time contains the lag of the wheels: neither host predicts it."""
    return load_spec(LAB, [f"controller={{{PLAIN}, dead_time: 0.06}}", "lab.lag=0", *sets])


def bench_spec(*sets: str) -> LoadedSpec:
    """The lab's spec on the bench, as far as the emulated lab is one."""
    plant = bench().model_dump(mode="json")
    plant["drive"]["dead_zone"] = 0  # the lab's spec has none; known exactly, it changes nothing
    plant |= {"measurement_noise": {}, "heading_noise": 0.0}
    plant["disturbances"] = [d for d in plant["disturbances"] if d["type"] != "frame-loss"]
    return lab_spec(f"plant={json.dumps(plant)}", *sets)


def bench_trial(spec: LoadedSpec, trial: int) -> TrialLog:
    """Run one trial of `bench_spec`."""
    return tetractl.run_trial(spec, trial)


def lab_trial(
    spec: LoadedSpec,
    trial: int,
    gain_error: float | None = None,
    camera: Mapping[str, float] = {},
    change: Callable[[VirtualLab], None] = lambda lab: None,
) -> TrialRecords:
    """Run one trial of `lab_spec` in the emulated lab, in virtual time.

    `gain_error` bounds that of each wheel, the bench's by default; `camera` are settings of the
    emulated one, and `change` may change the lab before it starts.
    """
    experiment = spec.experiment
    setup = experiment.setup
    drive = bench().drive
    planning = part(PlanningTimeSection)
    put = part(StartErrorSection)
    key, _ = trial_seeds(experiment.trials.seed, trial)
    rng = np.random.default_rng([experiment.trials.seed, trial])

    error = drive.gain_error if gain_error is None else gain_error

    def wheel() -> dict[str, float]:
        return {"gain_mm": drive.count * (1 + error * rng.uniform(-1, 1))}

    robots = [
        {
            "name": name,
            "left": wheel(),
            "right": wheel(),
            "radius_mm": setup.wheel_radius * (1 + drive.radius_error * rng.uniform(-1, 1)),
            "lag": drive.lag,
        }
        for name in setup.names
    ]
    off = rng.uniform(-1, 1, (3, len(robots))) * [[put.position], [put.position], [put.heading]]
    places = setup.starts.array() + off.T
    actuator = {"loss": part(RadioSection).loss, "robots": robots}
    script = "emulation: " + json.dumps({"camera": dict(camera), "actuator": actuator})
    with virtual_lab(None, spec=spec, script=script, seed=int(key % 2**31)) as lab:
        for robot, place in zip(lab.robots, places.tolist(), strict=True):
            robot.place(*place)
        change(lab)
        inner = build_controller(experiment, key)
        path = Recorder()
        busy = Busy(inner, lab.clock, rng, planning.least, planning.spread)
        start = create_start(spec, trial, PlantInfo("", False, 0.0, {}), SIMULATED_START_NS)
        Trial(start, lab.plant, busy, lab.clock, [path], Interrupt()).run()
    return path.trial
