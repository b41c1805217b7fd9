"""Whole trials generated from a seed; every number is random, so that no test passes by luck."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from tetractl.core.clock import SECOND
from tetractl.core.commands import Command, Stop
from tetractl.core.loggable import round_for_drawing
from tetractl.core.motion_estimate import INNOVATIONS, Estimate
from tetractl.core.plan import Outcome, Plan, Search, StopReason
from tetractl.core.poses import Floats, Observation, Poses, Sample
from tetractl.core.protocols import Observer
from tetractl.core.trial import SIMULATED_START_NS, PlantInfo, Result, Start, Step, Verdict
from tetractl.log import provenance
from tetractl.log.read.reader import read_trial
from tetractl.log.read.trial_log import TrialLog
from tetractl.log.write.writer import LogWriter
from tetractl.spec.experiment import Experiment
from tetractl.spec.loaded_spec import LoadedSpec, create_start

PERIOD_NS = SECOND // 5  # of a control step
SPEC_TEXT = "# as somebody wrote it\nname: made-up   # with a comment, and an ü\n"
OBSTACLES = [
    {"type": "rectangle", "left": 1200, "bottom": 1100, "width": 200, "height": 200},
    {"type": "circle", "center": [700, 1900], "radius": 50.5},
]

SMALL = {"robots": 2, "frames": 2, "first": 1, "iterations": 2, "length": 3}
"""Arguments of `trial` for control steps with few numbers."""


@dataclass(frozen=True)
class RandomTrial:
    """A trial as its loop would emit it: per control step the frames before it, and the step."""

    experiment: Experiment
    start: Start
    rounds: list[tuple[list[Sample], Step]]
    stop: Command
    result: Result

    @property
    def samples(self) -> list[Sample]:
        return [sample for samples, _ in self.rounds for sample in samples]

    def give_rounds(self, observer: Observer) -> None:
        """Tell an observer of every control step, as the loop does between start and stop."""
        for samples, step in self.rounds:
            observer.on_samples(samples)
            observer.on_step(step)

    @property
    def steps(self) -> list[Step]:
        return [step for _, step in self.rounds]


def experiment(robots: int = 3, **fields: Any) -> Experiment:
    document = {
        "name": "made-up",
        "arena": {"left": 600, "bottom": 350, "width": 1600, "height": 1800},
        "robots": [
            {
                "name": f"robot {i}",
                "start": [900, 800 + 100.1 * i],
                "heading": 0.1 * i,
                "target": [1700, 500 + 99.7 * i],
                "a": 6 / (1 + i),
                "speed": 180.5 - i,
                "color": ("green", "#0072b2", None)[i % 3],
            }
            for i in range(robots)
        ],
        "obstacles": OBSTACLES,
        "trials": {"count": 3, "seed": 2**64 - 1},
    }
    fields["controller"] = {"type": "pso-mpc"} | fields.get("controller", {})
    return Experiment.model_validate(document | fields)


def trial(
    seed: int = 1,
    *,
    robots: int = 3,
    steps: int = 8,
    simulated: bool = True,
    frames: int = 6,  # per control step
    first: int = 5,  # searches at step 0
    iterations: int = 10,
    length: int = 12,
    index: int = 0,
    host_ns: int = 1_000_000,
    **fields: Any,
) -> RandomTrial:
    """A trial of `steps` control steps at 5 Hz, the same for the same arguments."""
    rng = np.random.default_rng(seed)
    spec = experiment(robots, **fields)
    rounds = []
    for k in range(steps):
        numbers = range(k * frames, (k + 1) * frames)
        samples = [_sample(rng, number, frames, robots, simulated) for number in numbers]
        step = _step(rng, k, samples[-1].observation, first, iterations, length)
        rounds.append((samples, replace(step, solve_ns=step.solve_ns + host_ns)))
    result = _result(rng, robots, steps, simulated, host_ns)
    facts = {"a": repr(rng.random()), "fw": "ü=1"}
    start = create_start(
        LoadedSpec(spec, SPEC_TEXT, "made-up.yaml"),
        index,
        PlantInfo("sim" if simulated else "lab", simulated, 120.0, facts),
        SIMULATED_START_NS if simulated else 1_790_000_000_123_456_789,
    )
    delivered = rng.random(robots) < 0.5
    stop = Command(Stop(), steps * PERIOD_NS, tuple(delivered.tolist()))
    return RandomTrial(spec, start, rounds, stop, result)


def _sample(
    rng: np.random.Generator, number: int, frames: int, robots: int, simulated: bool
) -> Sample:
    """Frame `number` of a trial with so many `frames` a period."""
    k, frame = divmod(number, frames)
    sampled_ns = k * PERIOD_NS + frame * PERIOD_NS // frames
    received_ns = sampled_ns + 5_400_000
    valid = np.ones(robots, bool) if simulated else rng.random(robots) < 0.9
    poses = _poses(rng, robots)
    observation = Observation(number, sampled_ns, received_ns, poses, valid)
    truth = _single(_poses(rng, robots)) if simulated else None
    return Sample(observation, truth)


def _result(
    rng: np.random.Generator, robots: int, steps: int, simulated: bool, host_ns: int
) -> Result:
    final = _poses(rng, robots)
    errors = rng.uniform(0, 500, robots).tolist()
    verdict = Verdict(final, (True,) + (False,) * (robots - 1), _clearances(rng, robots))
    if not simulated:
        turn = tuple(rng.normal(0.0, 0.1, robots).tolist())
        verdict = replace(verdict, turn=turn, turn_std=(*[0.01] * (robots - 1), float("inf")))
    return Result(
        outcome=Outcome.SEQUENCE_COMPLETED,
        reason="no signal left",
        steps=steps,
        duration_s=steps * PERIOD_NS / SECOND,
        total_error=sum(errors),
        robot_errors=tuple(errors),
        verdict=verdict,
        solve_ns=tuple(int(n) + host_ns for n in rng.integers(0, 10**9, steps)),
        deadline_misses=host_ns % 7,
    )


def write(random_trial: RandomTrial, path: Path, environment: str = "{}\n") -> Path:
    """Write a made-up trial as the loop would, of a size that no checkout's state changes."""
    with (
        mock.patch.object(provenance, "environment", lambda: environment),
        LogWriter(path) as writer,
    ):
        writer.on_start(random_trial.start)
        random_trial.give_rounds(writer)
        writer.on_stop(random_trial.stop, random_trial.result)
    return path


def write_and_read(random_trial: RandomTrial, path: Path) -> TrialLog:
    """Write a made-up trial and read its log."""
    return read_trial(write(random_trial, path))


def _poses(rng: np.random.Generator, robots: int) -> Poses:
    return Poses.from_array(rng.normal(1000, 300, (robots, 3)))


def _single(poses: Poses) -> Poses:
    """True poses as precise as a log keeps them."""
    single = poses.array().astype(np.float32)
    return Poses.from_array(single.astype(np.float64))


def _as_logged(path: Floats) -> Floats:
    """A path as precise as a log keeps it, which has no headings."""
    return np.concatenate(
        [round_for_drawing(path[..., :2]), np.full_like(path[..., 2:], np.nan)], axis=-1
    )


def _clearances(rng: np.random.Generator, robots: int) -> tuple[float, ...]:
    return (float("inf"), *rng.normal(10, 30, robots - 1).tolist())


def _step(
    rng: np.random.Generator,
    k: int,
    observation: Observation,
    first: int,
    iterations: int,
    length: int,
) -> Step:
    robots = len(observation.valid)
    lengths = range(length - first + 1, length + 1) if k == 0 else (length - 1, length, length + 1)
    searches = tuple(
        Search(
            length=n,
            signals=rng.uniform(-np.pi, np.pi, n),
            cost=float(rng.uniform(0, 2000)),
            history=np.sort(rng.uniform(0, 2000, iterations + 1))[::-1].copy(),
            evaluations=int(rng.integers(1, 2**40)),
            stopped=StopReason(rng.choice(["criterion", "iterations"])),
        )
        for n in lengths
    )
    chosen = int(rng.integers(len(searches)))
    plan = Plan(
        signals=searches[chosen].signals,
        path=_as_logged(rng.normal(1000, 300, (lengths[chosen] + 1, robots, 3))),
        cost=searches[chosen].cost,
        target_cost=float(rng.uniform(0, 2000)),
        obstacle_cost=float(rng.integers(3)),
        searches=searches,
        chosen=chosen,
        generator=int(rng.integers(2**63, 2**64, dtype=np.uint64)),
        estimate=_estimate(rng, k, robots),
        numbers={"margin_mm": float(rng.normal(30, 10))} if k % 2 else {},
    )
    command = Command(
        action=plan.action,
        sent_ns=observation.received_ns + int(rng.integers(10**6)),
        delivered=tuple((rng.random(robots) < 0.9).tolist()),
        left=rng.normal(0, 200, robots) if k % 2 else None,
        right=rng.normal(0, 200, robots) if k % 2 else None,
    )
    solve_ns = int(rng.integers(10**9))
    missed = rng.random() < 0.1
    return Step(k, observation, plan, command, solve_ns, bool(missed))


def _estimate(rng: np.random.Generator, k: int, robots: int) -> Estimate | None:
    """No estimate, one of a and speed, and a whole one, in turn."""
    if k % 3 == 0:
        return None
    sure = [rng.uniform(0.1, 200, robots) for _ in range(4)]
    if k % 3 == 1:
        return Estimate(*sure)
    bias = rng.normal(0, 0.1, robots)
    bias_std = rng.uniform(0, 0.1, robots)
    names = ("side", "side_std", "saturation", "stands", "lag", "lag_std")
    others = {name: rng.uniform(0, 1, robots) for name in names}
    others["misfit"] = rng.uniform(0, 2, (robots, len(INNOVATIONS)))
    dead_time_std = float(rng.random())
    return Estimate(*sure, bias, bias_std, dead_time=0.0, dead_time_std=dead_time_std, **others)
