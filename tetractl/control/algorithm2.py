"""Algorithm 2 of the paper as published; the numbers of its lines stand next to the code.

The first step searches every length up to `horizon_max`, each later step the lengths H - 1, H and
H + 1 from what is left of the sequence in use; the best is exerted. Nothing is added here:
`tetractl.control.mpc` is the controller that we recommend.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from tetractl.control.estimator import StateEstimator
from tetractl.control.evaluate import compiled_foresee
from tetractl.control.fixed_sequence import make_plan
from tetractl.control.mpc_section import PsoMpc
from tetractl.control.rng import mix
from tetractl.control.trial_time import TrialTime
from tetractl.core.commands import Command
from tetractl.core.plan import End, Limits, Outcome, Plan, Search
from tetractl.core.poses import Floats, Observation
from tetractl.core.setup import Setup
from tetractl.experiment.controller import Host


class Algorithm2:
    """The controller of one trial; `key` seeds all its random numbers."""

    def __init__(self, section: PsoMpc, setup: Setup, key: int, host: Host) -> None:
        self.section = section
        self.key = key
        self.optimizer = host.wrap(section.optimizer)
        self.estimator = StateEstimator(
            section.problem(setup), section.period, section.known(setup), loss=setup.loss
        )
        # by default k_max alone ends the trial: late steps take longer than their periods
        steps_s = (section.steps_max + 1) * section.period
        limit_s = section.time_limit if section.time_limit < steps_s else math.inf
        self.time = TrialTime(limit_s, section.period)
        self.warm: Floats | None = None  # u_(warm), None before the first step
        self.k = 0  # control steps planned

    def plan(
        self,
        observation: Observation,
        last_command: Command | None = None,
        earlier: Sequence[Observation] = (),
    ) -> Plan | Outcome | End:
        """Decide u_(opt) of one control step, or end the trial."""
        problem = self.estimator.add_step(observation, last_command, earlier)  # 12: feedback
        if self.section.arrived(problem.poses.distances(problem.targets)):  # 13-15
            return Outcome.ARRIVED
        if self.k > self.section.steps_max:  # 9: for k = 1 ... k_max
            return Outcome.STEPS_MAX
        self.time.add_step(observation, last_command)
        if self.time.over:
            return Outcome.TIME_LIMIT
        if self.warm is not None and not len(self.warm):
            return Outcome.SEQUENCE_COMPLETED
        key = mix(self.key, self.k)
        searches: list[Search] = []
        for length, start in self._candidates():  # 2, 11
            search = self.optimizer.search(problem, length, start, mix(key, length), Limits())
            searches.append(search)  # 3, 21: u_(h) = pso(u_gb^0)
        best = int(np.argmin([search.cost for search in searches]))  # 5, 23: the u_(h) of least J
        plan = make_plan(searches, best, key, compiled_foresee(problem, searches[best].signals))
        self.warm = plan.signals[1:]  # 6, 24
        self.k += 1
        return plan.of_all(self.estimator.present, observation.poses)  # 7, 25: exert u_(opt)(1)

    def _candidates(self) -> Iterator[tuple[int, Floats | None]]:
        """Yield each length to search, counted in signals, with its u_gb^0."""
        if self.warm is None:
            for length in range(1, self.section.horizon_max + 1):  # 2: for h = 1 ... h_max
                yield length, None  # 3: NULL
            return
        count = len(self.warm)  # 10: H
        if count > 1:
            yield count - 1, self.warm[1:]  # 18-20: its last H - 1 signals
        yield count, self.warm  # 18-20: all its H signals
        yield count + 1, np.append(self.warm, 0.0)  # 16-17: and a 0
