"""Trials built in memory: the paper's three robots (section V), searched once, driven open loop."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from tetractl.core.commands import Command, PlantInfo, Sample, Verdict
from tetractl.core.plan import Outcome, Plan, Search, StopReason
from tetractl.core.poses import Floats, Observation, Poses
from tetractl.core.trial import EPOCH_NS, Result, Step
from tetractl.experiment.experiment import Experiment
from tetractl.experiment.load import LoadedSpec, start_of
from tetractl.log.read.trial_log import Damage, TrialLog
from tetractl.log.write.writer import LogWriter

PERIOD_S = 0.2
PERIOD_NS = 200_000_000
CAMERA_HZ = 120
FRAMES = 24  # camera frames in a period
FINE = 3  # integration steps a period when planning
ITERATIONS = 60

THREE_M3PI = {
    "name": "three-m3pi",
    "arena": {"left": 600, "bottom": 350, "width": 1600, "height": 1800},
    "robots": [
        {"name": "green", "start": [900, 800], "target": [1700, 500], "a": 6, "speed": 180},
        {"name": "blue", "start": [900, 1200], "target": [1700, 1500], "a": 4, "speed": 200},
        {"name": "red", "start": [900, 1600], "target": [1700, 2000], "a": 3, "speed": 150},
    ],
    "obstacles": [{"type": "rectangle", "left": 1200, "bottom": 1100, "width": 200, "height": 200}],
    "controller": {"arrival_tolerance": 20, "optimizer": {"iterations": ITERATIONS}},
}


def experiment(**changes: object) -> Experiment:
    """The reference experiment, with whole sections replaced."""
    return Experiment.model_validate({**THREE_M3PI, **changes})


def _drive(poses: Floats, signals: Floats, a: Floats, v: Floats, frames: int = FRAMES) -> Floats:
    """Integrate (1)-(3) under held signals (..., length): (length * frames + 1, ..., N, 3)."""
    dt = PERIOD_S / frames
    x, y, heading = (np.broadcast_to(c, (*signals.shape[:-1], len(a))) for c in poses.T)
    path = [np.stack([x, y, heading], axis=-1)]
    for u in np.moveaxis(signals, -1, 0):
        for _ in range(frames):
            x, y = x + dt * v * np.cos(heading), y + dt * v * np.sin(heading)
            heading = heading + dt * a * np.sin(u[..., None] - heading)
            path.append(np.stack([x, y, heading], axis=-1))
    return np.array(path)


def _cost(spec: Experiment, path: Floats) -> Floats:
    """J of (7) for paths (length + 1, P, N, 3): shape (P,)."""
    gap = path[-1, ..., :2] - np.array([robot.target for robot in spec.robots])
    cost = np.hypot(gap[..., 0], gap[..., 1]).sum(axis=-1)
    box = spec.obstacles[0]
    assert box.type == "rectangle"
    x, y = path[..., 0], path[..., 1]
    inside = (x >= box.left) & (x <= box.left + box.width)
    inside &= (y >= box.bottom) & (y <= box.bottom + box.height)
    return cost + 1000 * inside.sum(axis=(0, 2))


def _search(spec: Experiment, starts: Floats, length: int, rng: np.random.Generator) -> Search:
    """A small particle swarm, (14)-(19), stopped at random after iteration 10."""
    a = np.array([robot.a for robot in spec.robots])
    v = np.array([robot.speed for robot in spec.robots])
    u = rng.uniform(-np.pi, np.pi, (48, length))
    velocity = rng.uniform(-1, 1, u.shape)
    costs = _cost(spec, _drive(starts, u, a, v, FINE)[::FINE])
    own, own_cost = u.copy(), costs
    history = [float(own_cost.min())]
    for _ in range(int(rng.integers(30, ITERATIONS + 1))):
        best = own[own_cost.argmin()]
        r1, r2 = rng.random((2, *u.shape))
        velocity = 0.7 * velocity + 1.5 * r1 * (own - u) + 1.5 * r2 * (best - u)
        u = np.clip(u + velocity, -np.pi, np.pi)
        costs = _cost(spec, _drive(starts, u, a, v, FINE)[::FINE])
        better = costs < own_cost
        own[better], own_cost = u[better], np.minimum(own_cost, costs)
        history.append(float(own_cost.min()))
    stopped = StopReason.CRITERION if len(history) <= ITERATIONS else StopReason.ITERATIONS
    signals = own[own_cost.argmin()]
    return Search(length, signals, history[-1], np.array(history), 48 * len(history), stopped)


@cache
def three_robots(seed: int = 1) -> TrialLog:
    """A whole trial: about 8 s, 120 Hz, drifting off its plan by a few tens of mm a robot."""
    rng = np.random.default_rng(seed)
    spec = experiment()
    starts = np.array([[*robot.start, robot.heading] for robot in spec.robots])
    first = tuple(_search(spec, starts, n, rng) for n in range(26, 43, 2))
    chosen = min(range(len(first)), key=lambda i: first[i].cost)
    signals = first[chosen].signals

    a = np.array([r.a for r in spec.robots]) * rng.uniform(0.9, 1.1, 3)
    v = np.array([r.speed for r in spec.robots]) * rng.uniform(0.92, 1.04, 3)
    truth = _drive(starts, signals, a, v)
    mocap = truth + rng.normal(0, [1.5, 1.5, 0.01], truth.shape)
    mocap_ns = (np.arange(len(truth)) * 1e9 / CAMERA_HZ).round().astype(np.int64)
    valid = rng.random(truth.shape[:2]) > 0.01

    steps = []
    for k in range(len(signals)):
        now = k * PERIOD_NS
        poses = Poses.of(mocap[k * FRAMES])
        rest = signals[k:]
        path = _drive(
            poses.array(),
            rest,
            np.array([r.a for r in spec.robots]),
            np.array([r.speed for r in spec.robots]),
            frames=FINE,
        )[::FINE]
        cost = float(_cost(spec, path[:, None])[0])
        searches = first if k == 0 else _later(rest, cost, rng)
        pick = chosen if k == 0 else 1
        plan = Plan(rest, path, cost, cost % 1000, cost // 1000, searches, pick, generator=k)
        solve_ns = int(1e6 * (900 if k == 0 else rng.gamma(9, 12)))
        steps.append(
            Step(
                k=k,
                observation=Observation(k * FRAMES, now, now, poses, np.ones(3, bool)),
                plan=plan,
                command=Command(float(rest[0]), now, (True, True, True)),
                solve_ns=solve_ns,
                deadline_missed=k > 0 and solve_ns > PERIOD_NS,
            )
        )
    end_ns = len(signals) * PERIOD_NS
    gaps = truth[-1, :, :2] - np.array([robot.target for robot in spec.robots])
    errors = tuple(float(e) for e in np.hypot(*gaps.T))
    result = Result(
        outcome=Outcome.SEQUENCE_USED_UP,
        reason="no signal left in the warm start",
        steps=len(steps),
        duration_s=end_ns / 1e9,
        total_error=sum(errors),
        robot_errors=errors,
        verdict=Verdict(Poses.of(truth[-1]), (False,) * 3, (40.0, 12.0, 300.0)),
        solve_ns=tuple(step.solve_ns for step in steps),
        deadline_misses=sum(step.deadline_missed for step in steps),
    )
    trials = spec.trials.model_copy(update={"seed": seed})
    with_seed = spec.model_copy(update={"trials": trials})
    return TrialLog(
        path=f"trial-{seed:03d}.mcap",
        experiment=spec,
        start=start_of(
            LoadedSpec(with_seed, "", "three-m3pi.yaml"),
            0,
            PlantInfo("sim", True, CAMERA_HZ, {}),
            EPOCH_NS,
        ),
        mocap_ns=mocap_ns,
        mocap=mocap,
        valid=valid,
        truth=truth,
        steps=tuple(steps),
        stop=Command(None, end_ns, (True,) * 3),
        result=result,
        damage=None,
        host={},
        provenance={},
    )


def _later(rest: Floats, cost: float, rng: np.random.Generator) -> tuple[Search, ...]:
    """Three searches around a warm start, as Part II of Algorithm 2 makes them."""
    found = []
    for length in (len(rest) - 1, len(rest), len(rest) + 1):
        if length < 1:
            found.append(Search(1, rest[:1], cost, np.array([cost]), 48, StopReason.ITERATIONS))
            continue
        n = int(rng.integers(12, 30))
        end = cost * (1.0 if length == len(rest) else rng.uniform(1.0, 1.1))
        fall = 1 - np.sort(rng.beta(1, 3, n + 1))
        history = end * (1 + rng.uniform(0.05, 0.6) * (fall - fall[-1]) / (fall[0] - fall[-1]))
        signals = np.resize(rest, length)
        found.append(
            Search(length, signals, history[-1], history, 48 * n + 48, StopReason.CRITERION)
        )
    return tuple(found)


def cut_short(log: TrialLog, steps: int) -> TrialLog:
    """The same trial as a crash leaves it: the first steps, no stop, no result, damaged."""
    end = steps * FRAMES
    return replace(
        log,
        mocap_ns=log.mocap_ns[:end],
        mocap=log.mocap[:end],
        valid=log.valid[:end],
        truth=None if log.truth is None else log.truth[:end],
        steps=log.steps[:steps],
        stop=None,
        result=None,
        damage=Damage(("the file ends in the middle of a chunk",), (f"all after {steps / 5} s",)),
    )


def write_trial(log: TrialLog, path: Path) -> Path:
    """Store a trial as the trial loop would; without a result it stays a .part, as in a crash."""
    spec_text = json.dumps(log.experiment.model_dump(mode="json"))
    with LogWriter(path) as writer:
        writer.on_start(replace(log.start, spec_text=spec_text))
        frame = 0
        for step in log.steps:
            until = int(np.searchsorted(log.mocap_ns, step.command.sent_ns, side="right"))
            writer.on_samples(samples(log, frame, until))
            writer.on_step(step)
            frame = until
        writer.on_samples(samples(log, frame, len(log.mocap_ns)))
        if log.stop and log.result:
            writer.on_stop(log.stop, log.result)
            return path
    return path.with_name(path.name + ".part")


def samples(log: TrialLog, begin: int, end: int) -> list[Sample]:
    """Camera frames `begin` to `end`, as a plant gives them."""
    return [
        Sample(
            Observation(
                m, int(log.mocap_ns[m]), int(log.mocap_ns[m]), Poses.of(log.mocap[m]), log.valid[m]
            ),
            None if log.truth is None else Poses.of(log.truth[m]),
        )
        for m in range(begin, end)
    ]
