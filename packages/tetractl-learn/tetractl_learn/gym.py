"""Gymnasium environments for reinforcement learning, in which an episode is a simulated trial.

The module needs Gymnasium: `pip install './packages/tetractl-learn[gym]'`.

Importing this module registers the shipped benchmark specs, such as "tetractl/one-cell-v0".
`TrialEnv` accepts any spec whose plant is simulated.

Action: a vector (2,) in [-1, 1] that points in the direction to send: u = atan2(y, x). An angle
would jump at pi, so it is not used. Larger components are clipped, as a controller of type `policy`
clips them.

Observation (4 N + 2,) for N robots: gaps to the targets, headings and the last direction, computed
by `tetractl_learn.policy.compute_features`. All values are measured; the true poses are not
included.

Reward: the decrease of the measured sum of distances to the targets, divided by d, the sum of
distances at the starts. In the last step, the true error e of the result replaces the measured sum,
so that the rewards of an episode add up to 1 - e/d. If a robot enters an obstacle or leaves the
arena, the trial fails and ends. e is then the largest sum of distances that is possible in the
arena.

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
from tetractl_learn.policy import compute_features, count_features

GAP_MAX = 2.0
"""Maximum gap to a target in an observation, in units of the arena's longer side.

Within the arena, a gap is at most 1, but poses have noise.
"""
BENCHMARK_FOLDER = "benchmark"
"""The folder of the shipped specs that are registered as environments."""
N_SEEDS = 2**31
"""Number of possible seeds that `reset` samples from if no seed is given."""

RENDER_MODES = ["rgb_array"]
"""Gymnasium's names of the ways in which an environment can be rendered."""

Features = NDArray[np.float32]
"""Observation of a learner, shape (4 N + 2,)."""


class TrialEnv(gymnasium.Env[Features, Features]):
    """A Gymnasium environment in which each episode is a simulated trial of a spec.

    After an episode, `env.trial.save` writes the log of the trial.

    Args:
        spec: The experiment: a loaded spec, a YAML file, or its contents. Its plant must be
            simulated.
        render_mode: "rgb_array" if `render` is to draw images. None for no images.

    Raises:
        UsageError: If the render mode is unknown, or if the robots start on their targets.
    """

    metadata: dict[str, Any] = {"render_modes": RENDER_MODES}  # noqa: RUF012 - gymnasium.Env's

    def __init__(self, spec: Spec, render_mode: str | None = None) -> None:
        if render_mode not in (None, *RENDER_MODES):
            raise UsageError(f"render_mode {render_mode!r} is unknown", f"use {RENDER_MODES[0]}")
        self._spec = stepped(spec)
        setup = self._spec.experiment.setup
        self.render_mode = render_mode
        self.metadata = {"render_modes": RENDER_MODES, "render_fps": round(1 / setup.period_s)}
        self._start_distance_sum = float(setup.starts.distances(setup.targets).sum())
        if self._start_distance_sum == 0.0:
            raise UsageError(
                "the robots start on their targets, so that no reward can be earned",
                "move the starts or the targets apart in the spec",
            )
        n_features = count_features(len(setup.names))
        observation_max = np.ones(n_features, dtype=np.float32)
        observation_max[: 2 * len(setup.names)] = GAP_MAX
        self.observation_space = spaces.Box(-observation_max, observation_max, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (2,), dtype=np.float32)
        self._trial: OpenTrial | None = None
        self._places: list[Floats] = []  # measured positions (N, 2), one array for each step
        self._distance_sum = self._start_distance_sum

    @property
    def trial(self) -> OpenTrial:
        """The trial of the present episode, an `OpenTrial`.

        Raises:
            UsageError: If the environment was not reset yet.
        """
        if self._trial is None:
            raise UsageError("no trial runs", "call reset first")
        return self._trial

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[Features, dict[str, Any]]:
        """Start an episode: open a trial and return its first observation.

        Args:
            seed: Seed of the spec's `trials`. None for a random seed.
            options: {"trial": k} opens trial k of the seed. By default, trial 0. With the seed of a
                benchmark, trial k is the benchmark's trial k.

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
        trial_seed = int(self.np_random.integers(N_SEEDS)) if seed is None else seed
        trial = (options or {}).get("trial", 0)
        self._trial = OpenTrial(self._spec, trial, trial_seed)
        self._places = [self._trial.observation.poses.xy]
        self._distance_sum = self._start_distance_sum
        return self._observe(), {}

    def step(self, action: Features) -> tuple[Features, float, bool, bool, dict[str, Any]]:
        """Send a direction for one control period, and return what follows.

        Args:
            action: A vector (2,) that points in the direction. It is clipped to [-1, 1].

        Returns:
            The observation, the reward, whether the episode is terminated, whether it is truncated,
            and a mapping `info`. At the end of an episode, `info` contains the `outcome` and the
            `total_error` e [length unit].
        """
        along_x, along_y = np.clip(_convert_to_vector(action), -1.0, 1.0)
        observation = self.trial.step(math.atan2(along_y, along_x))
        self._places.append(observation.poses.xy)
        if self.trial.failed and self.trial.result is None:
            self.trial.stop()
        result = self.trial.result
        if result is None:
            distances = observation.poses.distances(self.trial.setup.targets)
            reward = self._take_reward(float(distances.sum()))
            return self._observe(), reward, False, False, {}
        failed = self.trial.failed
        error = compute_error_max(self.trial.setup) if failed else result.total_error
        terminated = failed or result.outcome is Outcome.ARRIVED
        info = {"outcome": "failed" if failed else result.outcome.value, "total_error": error}
        return self._observe(), self._take_reward(error), terminated, not terminated, info

    def render(self) -> NDArray[np.uint8] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Draw the arena and the paths of the episode so far as an RGB image (height, width, 3).

        The result is None without a render mode.
        """
        if self.render_mode is None:
            return None
        from tetractl.view.figures.trajectory import draw_arena_picture  # matplotlib, only if drawn

        return draw_arena_picture(self.trial.setup, np.array(self._places))

    def _take_reward(self, error: float) -> float:
        """Compute the reward: the decrease of the sum of distances since the last reward.

        The reward is a fraction of the sum at the starts. The next decrease counts from `error`.
        """
        decrease = self._distance_sum - error
        self._distance_sum = error
        return decrease / self._start_distance_sum

    def _observe(self) -> Features:
        """Compute the newest observation, with each feature clipped to the observation space."""
        trial = self.trial
        unbounded = compute_features(trial.setup, trial.observation, trial.last_direction)
        space = self.observation_space
        assert isinstance(space, spaces.Box)
        return np.clip(unbounded.astype(np.float32), space.low, space.high)


def _convert_to_vector(action: object) -> Floats:
    """Convert an action of a learner to a vector, shape (2,).

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


def compute_error_max(setup: Setup) -> float:
    """Compute the largest possible sum of the robots' distances to their targets [length unit].

    Each robot is then in the corner of the arena that is farthest from its target.
    """
    arena = setup.arena
    x = np.maximum(setup.targets[:, 0] - arena.left, arena.right - setup.targets[:, 0])
    y = np.maximum(setup.targets[:, 1] - arena.bottom, arena.top - setup.targets[:, 1])
    return float(np.hypot(x, y).sum())


def register_examples() -> None:
    """Register each shipped benchmark as a Gymnasium environment, "tetractl/NAME-v0"."""
    for name, file in find_examples().items():
        group, _, benchmark_name = name.rpartition("/")
        if group == BENCHMARK_FOLDER:
            gymnasium.register(
                f"tetractl/{benchmark_name}-v0",
                entry_point="tetractl_learn.gym:TrialEnv",
                kwargs={"spec": file},
            )


register_examples()
