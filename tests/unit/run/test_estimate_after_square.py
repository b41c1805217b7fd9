"""A trial that begins with a square, with the motion identified while driving."""

from support.paths import ROOT

from tetractl.experiment.load import load_spec
from tetractl.run.interrupt import Interrupt
from tetractl.run.task import run_trial

EXPERIMENT = ROOT / "experiments" / "three_m3pi.yaml"
SQUARE = [
    "controller.first_plan.type=square",
    "controller.first_plan.side=1.5",
    "controller.estimate=true",
]


def test_the_gap_of_the_square_is_not_believed_to_be_motion(tmp_path):
    """The robots are back at their start after 6 s: the way between is 0, the speed is not."""
    result = run_trial(load_spec(EXPERIMENT, SQUARE), tmp_path, 0, (), Interrupt())
    assert result.total_error < 1
    assert not result.entered_obstacle
