"""Test before a run whether this computer can plan in time and read the camera meanwhile.

A computer that is too slow or too busy sends commands late, and its robots drive on in old
directions. So before a run, `lab check` lets the controller steer simulated robots in real time for
some seconds, while the lab's camera sends frames. No robot moves: nothing is sent to the lab's
devices.

    delay     the time from when a step is due until its plan is known. The robots drive meanwhile,
              so a delay of more than a control period is late.
    silence   the longest time for which no frame of the lab's camera was read
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tetractl.core.clock import SECOND, Clock, milliseconds
from tetractl.core.plan import Outcome
from tetractl.core.protocols import Observer
from tetractl.core.trial import Step
from tetractl.lab.preflight import Preflight
from tetractl.run.checked_controller import build_controller
from tetractl.run.interrupt import Interrupt
from tetractl.run.spec_trial import ready_trial, trial_seeds
from tetractl.spec.lab_section import LabLimits
from tetractl.spec.loaded_spec import LoadedSpec
from tetractl.spec.plants import select_plant

PRACTICE_S = 3.0
"""Duration of the practice [s]."""
LATE_FRACTION_MAX = 0.2
"""Maximum fraction of late steps with which the practice is passed.

Five late steps in a row end a run. At this fraction, that happens in about one of eight trials of
400 steps, if steps are late independently of each other.
"""
FACT_NAME = "control steps"
"""Name of the fact in a preflight's findings that describes the delays of the steps."""


@dataclass(frozen=True, slots=True)
class Practice:
    """How well this computer kept up with the control steps of a short practice.

    Attributes:
        period_ns: The control period [ns].
        delays_ns: The delay of each step during which robots drove [ns].
        longest_silence_ns: The longest time for which no camera frame was read [ns].
    """

    period_ns: int
    delays_ns: tuple[int, ...]
    longest_silence_ns: int

    def add_to(self, findings: Preflight, limits: LabLimits) -> Preflight:
        """Add the results of this practice to the findings of a preflight.

        The result contains all findings. Late steps become a problem or a warning, and so does a
        pause of the camera. The delays are added to the facts.

        Args:
            findings: The findings so far.
            limits: The limits of the lab. Frames may be missing for at most its `stale` time.
        """
        problems = list(findings.problems)
        warnings = list(findings.warnings)
        facts = dict(findings.facts)
        step_count = len(self.delays_ns)
        period_ms = milliseconds(self.period_ns)
        if step_count:
            median_ms = milliseconds(int(np.median(self.delays_ns)))
            longest_ms = milliseconds(max(self.delays_ns))
            facts[FACT_NAME] = (
                f"median {median_ms:.0f} ms, at most {longest_ms:.0f} ms, for a period of "
                f"{period_ms:.0f} ms, in {step_count} steps with simulated robots"
            )
            late_count = sum(delay_ns > self.period_ns for delay_ns in self.delays_ns)
            late_text = (
                f"{late_count} of {step_count} practised control steps took longer than the "
                "control period"
            )
            if late_count > LATE_FRACTION_MAX * step_count:
                problems.append(f"this computer is too slow or too busy: {late_text}")
            elif late_count:
                warnings.append(f"{late_text}: is this computer busy?")
        if self.longest_silence_ns > limits.stale * SECOND:
            problems.append(
                "this computer is too busy, or the camera pauses: no frame was read for "
                f"{milliseconds(self.longest_silence_ns):.0f} ms during the practised control "
                f"steps, but robots stop after {1000 * limits.stale:.0f} ms"
            )
        return replace(findings, problems=tuple(problems), warnings=tuple(warnings), facts=facts)


class PacedSteps(Observer):
    """An observer that slows the control steps of simulated trials down to real time.

    It measures how late each step is.

    Args:
        period_ns: The control period [ns].
        clock: The clock by which steps are due.
        read_silence_ns: Returns the time since the last camera frame was read [ns].
        interrupt: Ends the trial that is still running after PRACTICE_S.

    Attributes:
        delays_ns: The delay of each step during which robots drove [ns].
        longest_silence_ns: The longest time for which no camera frame was read [ns].
        step_count: Number of control steps so far.
        is_over: Whether PRACTICE_S has passed.
    """

    def __init__(
        self, period_ns: int, clock: Clock, read_silence_ns: Callable[[], int], interrupt: Interrupt
    ) -> None:
        self.delays_ns: list[int] = []
        self.longest_silence_ns = 0
        self.step_count = 0
        self.is_over = False
        self._period_ns = period_ns
        self._clock = clock
        self._read_silence_ns = read_silence_ns
        self._interrupt = interrupt
        self._due_ns: int | None = None  # due time of the present step, None if robots stood before
        self._end_ns = 0

    def on_step(self, step: Step) -> None:
        """Measure the delay of a step, and wait until the next one is due."""
        now_ns = self._clock.now()
        if self.step_count == 0:
            self._end_ns = now_ns + round(PRACTICE_S * SECOND)
        self.step_count += 1
        if step.k == 0:
            self._due_ns = None  # the robots stood while the first plan was computed
        self.longest_silence_ns = max(self.longest_silence_ns, self._read_silence_ns())
        due_ns = now_ns
        if self._due_ns is not None:
            self.delays_ns.append(now_ns - self._due_ns)
            due_ns = max(self._due_ns, now_ns - self._period_ns)
        due_ns += self._period_ns
        if due_ns > self._end_ns:
            self.is_over = True
            self._interrupt.request()
            return
        self._clock.sleep_until(due_ns)
        self.longest_silence_ns = max(self.longest_silence_ns, self._read_silence_ns())
        self._due_ns = None if step.plan.pauses else due_ns


def practise(spec: LoadedSpec, clock: Clock, read_silence_ns: Callable[[], int]) -> Practice:
    """Let the controller of a spec steer simulated robots for PRACTICE_S.

    Args:
        spec: The spec of a lab with known robots. Its controller's code is compiled.
        clock: The host's clock, by which steps are due.
        read_silence_ns: Returns the time since the last frame of the lab's camera was read [ns].

    Raises:
        KeyboardInterrupt: If a signal has ended the practice.
    """
    interrupt = Interrupt()
    period_ns = round(spec.experiment.controller.period * SECOND)
    paced_steps = PacedSteps(period_ns, clock, read_silence_ns, interrupt)
    key, _ = trial_seeds(spec.experiment.trials.seed, 0)
    simulated = select_plant(spec, "sim")
    while not paced_steps.is_over:  # trials may be short
        steps_before = paced_steps.step_count
        controller = build_controller(spec.experiment, key)  # in the lab it obeys a real deadline
        with ready_trial(simulated, 0, [paced_steps], interrupt, controller=controller) as trial:
            result = trial.run()
        if result.outcome is Outcome.INTERRUPTED and not paced_steps.is_over:
            raise KeyboardInterrupt
        if paced_steps.step_count == steps_before:
            break
    return Practice(period_ns, tuple(paced_steps.delays_ns), paced_steps.longest_silence_ns)
