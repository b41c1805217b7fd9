"""A trial as a Gymnasium environment, for reinforcement learning.

The module needs Gymnasium: `pip install './packages/tetractl-learn[gym]'`.

Importing it registers the shipped benchmark specs, such as "tetractl/one-cell-v0". `TrialEnv`
accepts any spec whose plant is simulated.

Action: a vector (2,) in [-1, 1] that points in the direction to send: u = atan2(y, x). An angle
would jump at pi, so it is not used. Larger components are clipped, as a controller of type `policy`
clips them.

Observation (4 N + 2,) for N robots: gaps to the targets, headings and the last direction, computed
by `tetractl_learn.policy.features`. All values are measured; the true poses are not included.

Reward: the decrease of the measured sum of distances to the targets, divided by this sum at the
starts, d. In the last step, the true error e of the result replaces the measured sum, so that the
rewards of an episode add up to 1 - e/d. If a robot enters an obstacle or leaves the arena, the
trial fails and ends. e is then the largest sum of distances that is possible in the arena.

An episode is terminated if the trial fails in this way, or if each robot has arrived within the
spec's `arrival_tolerance`. It is truncated at the time limit, or if the trial is aborted. The
shipped benchmarks have no tolerance, so set the one that your task needs.

Rendering, in the mode "rgb_array": an image of the arena and the measured paths so far.
"""

import math
from collections.abc import Mapping
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from tetractl.api.simulated_trials import stepped
from tetractl.api.specs import Spec
from tetractl.core.errors import UsageError, printable
from tetractl.core.plan import Outcome
from tetractl.core.poses import Floats
from tetractl.core.setup import Setup
from tetractl.run.open_trial import OpenTrial
from tetractl.spec.examples import find_examples
from tetractl_learn.policy import features, features_of

GAP_MAX = 2.0
"""Maximum gap in an observation, in units of the arena's longer side: 1 within the arena, plus
noise.
"""
BENCHMARKS = "benchmark"
"""The folder of the shipped specs that are registered."""
SEEDS = 2**31
"""Number of seeds from which `reset` samples one if none is given."""

RENDER_MODES = ["rgb_array"]
"""The modes of Gymnasium in which an environment shows itself."""

Features = NDArray[np.float32]
"""Observation of a learner, shape (4 N + 2,)."""


class TrialEnv(gymnasium.Env[Features, Features]):
    """A Gymnasium environment that runs one simulated trial of a spec after another.

    `trial` is the trial that runs, an `OpenTrial`. After an episode, its method `save` writes a
    log.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES}  # noqa: RUF012 - gymnasium.Env's

    def __init__(self, spec: Spec, render_mode: str | None = None) -> None:
        if render_mode not in (None, *RENDER_MODES):
            raise UsageError(f"render_mode {render_mode!r} is unknown", f"use {RENDER_MODES[0]}")
        self._spec = stepped(spec)
        setup = self._spec.experiment.setup
        self.render_mode = render_mode
        self.metadata = {"render_modes": RENDER_MODES, "render_fps": round(1 / setup.period_s)}
        self._start_error = float(setup.starts.distances(setup.targets).sum())
        if self._start_error == 0.0:
            raise UsageError(
                "the robots start on their targets, so that no reward can be earned",
                "move the starts or the targets apart in the spec",
            )
        size = features_of(len(setup.names))
        high = np.ones(size, dtype=np.float32)
        high[: 2 * len(setup.names)] = GAP_MAX
        self.observation_space = spaces.Box(-high, high, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), dtype=np.float32)
        self._trial: OpenTrial | None = None
        self._ways: list[Floats] = []  # measured places (N, 2) of the episode so far
        self._error = self._start_error

    @property
    def trial(self) -> OpenTrial:
        """The trial of the present episode.

        Raises:
            UsageError: If the environment was not reset yet.
        """
        if self._trial is None:
            raise UsageError("no trial runs", "call reset first")
        return self._trial

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Features, dict[str, Any]]:
        """Open a trial and return its first observation.

        Args:
            seed: Seed of the spec's `trials`. None for a random seed.
            options: {"trial": k} opens trial k. By default, trial 0. With the benchmark's seed,
                these are the benchmark's trials.

        Returns:
            The observation, shape (4 N + 2,), and an empty mapping.
        """
        unknown = sorted(set(options or {}) - {"trial"})
        if unknown:
            raise UsageError(
                f"reset() has no option {unknown[0]!r}",
                "the only option is 'trial', the trial's index",
            )
        super().reset(seed=seed)
        trial_seed = int(self.np_random.integers(SEEDS)) if seed is None else seed
        trial = (options or {}).get("trial", 0)
        self._trial = OpenTrial(self._spec, trial, trial_seed)
        self._ways = [self._trial.observation.poses.xy]
        self._error = self._start_error
        return self._observed(), {}

    def step(self, action: Features) -> tuple[Features, float, bool, bool, dict[str, Any]]:
        """Send a direction for one control period.

        Args:
            action: A vector (2,) that points in the direction. It is clipped to [-1, 1].

        Returns:
            The observation, the reward, whether the episode is terminated, whether it is truncated,
            and `info`. At the end of an episode, `info` contains the `outcome` and the
            `total_error` e [length unit].
        """
        along_x, along_y = np.clip(_vector(action), -1.0, 1.0)
        observation = self.trial.step(math.atan2(along_y, along_x))
        self._ways.append(observation.poses.xy)
        if self.trial.failed and self.trial.result is None:
            self.trial.stop()
        result = self.trial.result
        if result is None:
            distances = observation.poses.distances(self.trial.setup.targets)
            reward = self._take_reward(float(distances.sum()))
            return self._observed(), reward, False, False, {}
        failed = self.trial.failed
        error = greatest_error(self.trial.setup) if failed else result.total_error
        terminated = failed or result.outcome is Outcome.ARRIVED
        info = {"outcome": "failed" if failed else result.outcome.value, "total_error": error}
        return self._observed(), self._take_reward(error), terminated, not terminated, info

    def render(self) -> NDArray[np.uint8] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Draw the episode so far as an RGB image, shape (height, width, 3).

        The result is None without a render mode.
        """
        if self.render_mode is None:
            return None
        from tetractl.view.figures.trajectory import draw_arena_picture  # matplotlib, only if drawn

        return draw_arena_picture(self.trial.setup, np.array(self._ways))

    def _take_reward(self, error: float) -> float:
        """Compute the reward: the decrease of the sum of distances since the last reward.

        The reward is a fraction of the sum at the starts. The next decrease counts from `error`.
        """
        decrease = self._error - error
        self._error = error
        return decrease / self._start_error

    def _observed(self) -> Features:
        """Return the newest observation, with each feature clipped to the bounds of the space."""
        trial = self.trial
        unbounded = features(trial.setup, trial.observation, trial.last_direction)
        space = self.observation_space
        assert isinstance(space, spaces.Box)
        return np.clip(unbounded.astype(np.float32), space.low, space.high)


def _vector(action: object) -> Floats:
    """Convert an action to a vector (2,).

    Raises:
        UsageError: If the action is not a vector of 2 finite numbers.
    """
    try:
        vector = np.asarray(action, dtype=np.float64)
    except (TypeError, ValueError):
        vector = np.empty(0)
    if vector.shape != (2,) or not np.isfinite(vector).all():
        raise UsageError(
            f"an action must be a vector of 2 finite numbers, not {printable(repr(action), 60)}",
            "give cos u and sin u of the direction u to send",
        )
    return vector


def greatest_error(setup: Setup) -> float:
    """Compute the largest sum of the robots' distances to their targets in the arena [length unit].

    Each robot is then in the corner of the arena that is farthest from its target.
    """
    arena = setup.arena
    x = np.maximum(setup.targets[:, 0] - arena.left, arena.right - setup.targets[:, 0])
    y = np.maximum(setup.targets[:, 1] - arena.bottom, arena.top - setup.targets[:, 1])
    return float(np.hypot(x, y).sum())


def register_examples() -> None:
    """Register each shipped benchmark as an environment, "tetractl/NAME-v0"."""
    for name, file in find_examples().items():
        group, _, short = name.rpartition("/")
        if group == BENCHMARKS:
            gymnasium.register(
                f"tetractl/{short}-v0",
                entry_point="tetractl_learn.gym:TrialEnv",
                kwargs={"spec": file},
            )


register_examples()
