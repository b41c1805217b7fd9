"""What outcomes mean, for readers of tables and reports."""

from collections.abc import Mapping

from tetractl.core.plan import Outcome

MEANINGS: Mapping[Outcome, str] = {
    Outcome.ARRIVED: "every robot is within the arrival tolerance of its target",
    Outcome.SEQUENCE_COMPLETED: "every signal was sent",
    Outcome.NO_BETTER_PLAN: "stopped where driving on would gain too little",
    Outcome.STEPS_MAX: "the largest number of control steps was reached",
    Outcome.TIME_LIMIT: "the trial's time was over",
    Outcome.INTERRUPTED: "Ctrl-C, `tetractl lab stop` or another signal ended the trial",
    Outcome.ABORTED: "a fault or an error ended the trial",
}
