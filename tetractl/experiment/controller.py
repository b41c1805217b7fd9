"""The controller's part of a spec: MPC (Algorithm 2) and the swarm inside it (Algorithm 1)."""

from typing import Annotated, Literal, Self

from pydantic import Field, PositiveInt, model_validator

from tetractl.experiment.base import Model, NonNegative, Positive, inconsistent
from tetractl.experiment.choice import Choice, OneOf
from tetractl.experiment.kinds import MOTIONS, OPTIMIZERS


class PaperStop(Model):
    """Stop criterion (20) as printed: it compares logarithms of lengths, so it depends on the
    length unit."""

    type: Literal["paper"]


class RelativeStop(Model):
    """Stop when the best cost has fallen by less than `decrease` of itself over `window`
    iterations."""

    type: Literal["relative"]
    window: int = Field(default=10, ge=1, le=10_000)
    """Iterations looked back over."""
    decrease: float = Field(default=0.01, ge=0, lt=1, allow_inf_nan=False)
    """Least relative decrease of J over the window that keeps the search going."""


class TargetStop(Model):
    """Stop as soon as the best cost J is at or below `cost` (in the spec's length unit)."""

    type: Literal["target"]
    cost: Positive
    """The cost J that is good enough [length unit]."""


class BudgetStop(Model):
    """Never stop early: always spend every iteration."""

    type: Literal["budget"]


Stop = Annotated[PaperStop | RelativeStop | TargetStop | BudgetStop, Field(discriminator="type")]


class SwarmSpec(Model):
    """Particle swarm of Algorithm 1, (14)-(19)."""

    type: Literal["pso"] = "pso"
    particles: int = Field(default=100, ge=1, le=1_000_000)
    """Number of particles np."""
    iterations: int = Field(default=100, ge=1, le=1_000_000)
    """Largest number of iterations z_max of one search (one horizon)."""
    inertia: float = Field(default=0.7, gt=0, le=2, allow_inf_nan=False)
    """Momentum omega_v of (14)."""
    cognitive: float = Field(default=1.5, gt=0, le=10, allow_inf_nan=False)
    """Weight c1 of (14), towards a particle's own best."""
    social: float = Field(default=1.5, gt=0, le=10, allow_inf_nan=False)
    """Weight c2 of (14), towards the swarm's best."""
    stop: Stop = PaperStop(type="paper")
    """When a search ends before `iterations`."""


class MultistartSpec(Model):
    """Many starts, the best polished by Levenberg-Marquardt; see docs/explanation/solver.md.

    Each round scatters `particles` smooth random sequences, evaluates them as a swarm is, and
    polishes the best `polished` of them until one has a cost of at most `tolerance`.
    """

    type: Literal["multistart"]
    particles: int = Field(default=128, ge=1, le=1_000_000)
    """Sequences scattered in each round."""
    knots: int = Field(default=12, ge=2, le=1000)
    """Random directions that each of them passes through, evenly spread over its length."""
    polished: int = Field(default=4, ge=1, le=10_000)
    """The best of a round that are polished."""
    polish_steps: int = Field(default=40, ge=1, le=10_000)
    """Levenberg-Marquardt iterations spent on each at most."""
    rounds: int = Field(default=8, ge=1, le=10_000)
    """Rounds of one search without a warm start; with one that cannot be polished, a single one."""
    tolerance: Positive = 0.001
    """Cost J at which a sequence is good enough and the search ends [length unit]."""

    @property
    def iterations(self) -> int:
        """Iterations spent on one start at most."""
        return self.polish_steps


Optimizer = Annotated[SwarmSpec | MultistartSpec, Choice(OPTIMIZERS, default="pso")]


class Collision(Model):
    """How the planner's potential (13) decides that a robot is inside an obstacle."""

    check: Literal["samples", "swept"] = "samples"
    """`samples` tests the predicted positions as (13) is printed; `swept` tests the whole segment
    between two of them."""
    margin: NonNegative = 0.0
    """Obstacles are grown by this much for the planner [length unit]."""
    walls: bool = False
    """Whether leaving the arena counts as entering an obstacle."""


class NoWait(Model):
    """The robots stand still while the first plan is computed."""

    type: Literal["stand"]


class Square(Model):
    """The robots drive a square while the first plan is computed and return to their start
    (IV-B.1)."""

    type: Literal["square"]
    side: Positive = 2.0
    """Time spent on each side [s]; several times 1/a, so that the square closes."""
    laps: int = Field(default=1, ge=1, le=100)
    """Whole squares to drive: exactly this many in simulation, at least this many in the lab."""


FirstPlan = Annotated[NoWait | Square, Field(discriminator="type")]


class PsoMpcSpec(Model):
    """PSO inside model predictive control, Algorithm 2."""

    type: Literal["pso-mpc"] = "pso-mpc"
    period: Positive = 0.2
    """Control period T [s] (the paper's experiment: 5 Hz)."""
    hold: PositiveInt = 1
    """Control periods for which each signal of a sequence is meant to be held: the plan's grid is
    `hold` times coarser than the control's, and a signal under way can still be changed."""
    dead_time: float = Field(default=0.0, ge=0, le=10, allow_inf_nan=False)
    """From measurement to actuation, as the controller believes it [s]: it plans from where the
    robots will be by then under the directions already sent."""
    motion: Annotated[str, OneOf(MOTIONS)] = "euler"
    """Motion the prediction is made with: `euler` is (4)-(6); `arc` holds the wheel speeds of (24)-(25) over a period;
    `exact` is the closed form of (1)-(3) under a held direction."""
    estimate: bool = False
    """Whether a and speed of each robot are estimated while it moves, starting from the spec's.
    The estimate trusts `dead_time`: where that is far off, it learns a wrong a."""
    horizon_max: int = Field(default=51, ge=1, le=2000)
    """Longest sequence tried at step 0, in signals. A sequence of `length` signals is the paper's
    horizon h = length - 1."""
    steps_max: int = Field(default=100, ge=1, le=1_000_000)
    """Largest number of control steps k_max."""
    arrival_tolerance: NonNegative = 0.0
    """The robots are close enough when every one is within this distance of its target [length
    unit]; 0 never ends a trial early."""
    obstacle_weight: NonNegative = 1000.0
    """Weight omega_p of the obstacle potential in (7) [length unit]."""
    collision: Collision = Collision()
    """How the planner tells that a robot is inside an obstacle."""
    first_plan: FirstPlan = NoWait(type="stand")
    """What the robots do while the first plan is computed."""
    evaluations_max: int | None = Field(default=None, ge=1)
    """Cost evaluations one control step may spend, shared equally by its horizons; then the best
    sequence so far is used. No limit by default."""
    deadline: Positive | None = None
    """Time after which a control step uses the best sequence so far [s]; it only cuts searches
    short, and does not hold at step 0. None by default: a simulation then depends on its seed
    alone."""
    swarm: Optimizer = SwarmSpec()
    """The optimiser of each search."""

    @model_validator(mode="after")
    def _a_budget_pays_for_a_swarm(self) -> Self:
        least = self.swarm.particles + 1
        if self.evaluations_max is not None and self.evaluations_max < least:
            raise inconsistent("evaluations_max", f"must be at least particles + 1, {least}")
        return self
