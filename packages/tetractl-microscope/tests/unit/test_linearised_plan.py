"""Tests of a linearised plan against the ends of changed plans."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testkit.problems import problem, world
from tetractl_microscope.choice.closed_loop import LinearisedPlan, linearise_plan

from tetractl.control.search.cost import predict
from tetractl.core.plan import Problem
from tetractl.core.poses import Floats, Poses

SMALL = 1e-6  # change of signals [rad], headings [rad], and of ln a and ln speed
FIRST_PERIOD_S = 0.13
SIGNALS = 9
seeds = st.integers(0, 10_000)
motions = st.sampled_from(("euler", "exact"))


@dataclass(frozen=True)
class Plan:
    """Random signals [rad] for robots at random poses, and the plan linearised."""

    problem: Problem
    signals: Floats
    linear: LinearisedPlan


def random_plan(seed, motion):
    random_problem = replace(problem(world(seed, model=motion)), first_period=FIRST_PERIOD_S)
    signals = np.random.default_rng(seed).uniform(-3, 3, SIGNALS)
    return Plan(random_problem, signals, linearise_plan(random_problem, signals))


def ends(problem, signals):
    """Where the robots end, (N, 2)."""
    return predict(problem, signals)[-1, :, :2]


def derivative(ends_after):
    """The central difference of the ends after a change of this size."""
    return (ends_after(SMALL) - ends_after(-SMALL)) / (2 * SMALL)


def assert_agrees(ours, expected, relative):
    assert ours == pytest.approx(expected, rel=relative, abs=relative * np.abs(expected).max())


@pytest.mark.long
@given(seeds, motions)
def test_ends_by_each_signal(seed, motion):
    plan = random_plan(seed, motion)

    def by_signal(k):
        def ends_with(change):
            signals = plan.signals.copy()
            signals[k] += change
            return ends(plan.problem, signals)

        return derivative(ends_with).ravel()

    columns = [by_signal(k) for k in range(SIGNALS)]
    assert_agrees(plan.linear.by_signal, np.transpose(columns), 1e-6)


@given(seeds, motions)
def test_ends_by_heading(seed, motion):
    plan = random_plan(seed, motion)
    poses = plan.problem.poses

    def ends_turned(angle):
        turned = Poses(poses.x, poses.y, poses.heading + angle)
        return ends(replace(plan.problem, poses=turned), plan.signals)

    assert_agrees(plan.linear.by_heading[0], derivative(ends_turned), 1e-4)


@given(seeds, motions)
def test_ends_by_a(seed, motion):
    plan = random_plan(seed, motion)

    def ends_with(change):
        a = plan.problem.a * (1 + change)
        return ends(replace(plan.problem, a=a), plan.signals)

    assert_agrees(plan.linear.by_a.sum(axis=0), derivative(ends_with), 1e-4)


@given(seeds, motions)
def test_ends_by_speed(seed, motion):
    plan = random_plan(seed, motion)

    def ends_with(change):
        speed = plan.problem.speed * (1 + change)
        return ends(replace(plan.problem, speed=speed), plan.signals)

    assert_agrees(plan.linear.by_speed.sum(axis=0), derivative(ends_with), 1e-4)


def test_a_robot_goes_on_for_a_period_at_its_speed():
    plan = random_plan(3, "exact")
    onward = plan.linear.extra_step.reshape(-1, 2)
    ways = plan.problem.period * plan.problem.speed
    assert np.linalg.norm(onward, axis=1) == pytest.approx(ways)


def test_the_plan_misses_by_the_distances_of_its_ends_to_the_targets():
    plan = random_plan(3, "exact")
    gaps = ends(plan.problem, plan.signals) - plan.problem.targets
    assert plan.linear.target_distances == pytest.approx(np.linalg.norm(gaps, axis=1))


def test_the_first_signal_has_a_period_of_its_own():
    plan = random_plan(3, "exact")
    later = [plan.problem.period] * (SIGNALS - 1)
    assert plan.linear.durations_s.tolist() == [FIRST_PERIOD_S, *later]
