"""Tests of lab trials that send given directions, in virtual time, and of how they end."""

import pytest
from testkit.labs import fake_lab
from testkit.trials import experiment

from tetractl.control.methods.sequence import SequenceSection
from tetractl.core.clock import SECOND
from tetractl.core.plan import Outcome
from tetractl.core.trial import SIMULATED_START_NS, PlantInfo
from tetractl.run.control_loop import Trial
from tetractl.run.interrupt import Interrupt
from tetractl.spec.loaded_spec import LoadedSpec, create_start

pytestmark = pytest.mark.slow

STEPS = 8
PERIOD_S = 0.2
REMAINDER_S = 0.15


def driven(dies_s=None):
    """The result of a trial whose radio dies so long after the first direction."""
    spec = experiment()
    lab = fake_lab(spec.setup)
    section = SequenceSection(
        period=PERIOD_S,
        time_limit=(STEPS + 1) * PERIOD_S,
        directions=(0.5,) * STEPS,
        remainder=REMAINDER_S,
    )
    spec = spec.model_copy(update={"controller": section})

    def die():
        if lab.actuator.sent and dies_s is not None:
            began = lab.actuator.sent[0].sent_ns
            if lab.clock.now() - began >= dies_s * SECOND and lab.actuator.failure is None:
                lab.actuator.failure = "the radio is gone"
                lab.world.moving = (False,) * 3  # their watchdog stops them

    lab.clock.steps.append(die)
    info = PlantInfo("", False, 0.0, {})
    return Trial(
        create_start(LoadedSpec(spec, "", "spec.yaml"), 0, info, SIMULATED_START_NS),
        lab.plant,
        section.build(spec.setup, 1),
        lab.clock,
        [],
        Interrupt(),
    ).run()


@pytest.mark.parametrize("dies_s", [0.0, 0.1, 0.7, 1.5, 1.61, 1.7, 1.76])
def test_a_radio_that_dies_at_any_time_aborts_the_trial(dies_s):
    """Regression: after the last observation nothing noticed, and the trial counted as complete."""
    result = driven(dies_s)
    assert (result.outcome, result.reason) == (Outcome.ABORTED, "the radio is gone")
