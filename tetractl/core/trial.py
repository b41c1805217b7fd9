"""The records of a trial: its start, each control step, its result."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from tetractl.core.commands import Command, PlantInfo, Verdict
from tetractl.core.plan import Outcome, Plan
from tetractl.core.poses import Observation
from tetractl.core.setup import Setup

EPOCH_NS = 1_577_836_800_000_000_000  # 2020-01-01 UTC: virtual trials start here, so logs repeat


@dataclass(frozen=True, slots=True)
class Start:
    """Everything known before the first step of a trial.

    `resolved` is the spec as YAML with every field, defaults and `--set` applied; `spec_hash` is
    the SHA-256 of its values, as 64 hex digits. `packages` are name and version of the packages
    beside tetractl that provide a kind which the spec uses.
    """

    setup: Setup
    spec_text: str  # as written
    spec_name: str  # file name of the spec
    resolved: str
    spec_hash: str
    seed: int  # root of the batch's random numbers
    trial: int  # index in the batch, from 0
    plant: PlantInfo
    start_unix_ns: int  # trial clock 0 in Unix time; EPOCH_NS in simulation
    attached: tuple[tuple[str, str], ...] = ()  # name and text of files the spec draws on
    packages: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Step:
    """One control step k: what was seen, decided and sent.

    `solve_ns` and `deadline_missed` are host facts: they differ from run to run on the same seed.
    """

    k: int
    observation: Observation
    plan: Plan
    command: Command
    solve_ns: int
    deadline_missed: bool


@dataclass(frozen=True, slots=True)
class Result:
    """How a trial ended. Lengths are in the experiment's unit; errors are to the targets."""

    outcome: Outcome
    reason: str
    steps: int
    duration_s: float
    total_error: float
    robot_errors: tuple[float, ...]
    verdict: Verdict
    solve_ns: tuple[int, ...] = field(repr=False)  # host facts, one a step
    deadline_misses: int = 0  # host fact

    @property
    def entered_obstacle(self) -> bool:
        """Whether any robot was truly inside an obstacle."""
        return any(self.verdict.entered)
