"""Run the simulation of a log again, and compare the two logs record by record.

This needs the host and the code that wrote the log.
"""

from collections.abc import Iterator

from tetractl.core.errors import TetractlError
from tetractl.core.plan import Outcome, StopReason
from tetractl.log.format.channels import WRITER, Record
from tetractl.log.provenance import TRIAL_CODE_KEY
from tetractl.log.read import limits
from tetractl.log.read.raw_log import RawLog
from tetractl.log.read.trial_log import TrialLog
from tetractl.log.write.encoder import Encoder, RecordSink
from tetractl.run.interrupt import Interrupt
from tetractl.run.spec_trial import ready_trial
from tetractl.run.task import code_hash
from tetractl.tools.kernels.kernel_cache import computing_s
from tetractl.verification.comparison import Difference, Unchecked
from tetractl.verification.log_comparison import log_differences


class RecordCollector(RecordSink):
    """A sink that keeps all records of a trial, and stops the trial after a deadline.

    Args:
        deadline_s: Processor time, as `computing_s` returns it, after which the trial is asked to
            stop [s].

    Attributes:
        records: The records so far.
        interrupt: The interrupt with which the trial must run.
        is_late: Whether the deadline has passed.
    """

    def __init__(self, deadline_s: float) -> None:
        self.records: list[Record] = []
        self.interrupt = Interrupt()
        self.is_late = False
        self._deadline_s = deadline_s

    def add(self, record: Record) -> None:
        """Keep a record of the trial that is run again.

        The first record after the deadline sets `is_late`, and asks the trial to end.
        """
        self.records.append(record)
        if computing_s() > self._deadline_s and not self.is_late:
            self.is_late = True
            self.interrupt.request()


def why_not_again(log: TrialLog, elsewhere: tuple[str, ...]) -> str:
    """Explain why the trial of an undamaged log cannot be repeated exactly on this computer.

    Args:
        log: The log.
        elsewhere: The differences between the log's computer and this one.

    Returns:
        The reason. Empty if the trial can be repeated.
    """
    plant = log.experiment.plant
    result = log.result
    searches = (search for step in log.steps for search in step.plan.searches)
    if not (log.start.plant.simulated and plant.simulated) or plant.real_time or result is None:
        return "it is not a simulation in virtual time"
    if elsewhere or log.facts.get(TRIAL_CODE_KEY) != code_hash(log.experiment):
        return "it was written on another computer, or by other code"
    if result.outcome is Outcome.INTERRUPTED:
        return "it was interrupted"
    if any(search.stopped == StopReason.DEADLINE for search in searches):
        return "a deadline ended one of its searches"
    return ""


def differences(raw_log: RawLog, log: TrialLog) -> Iterator[Difference]:
    """Run the trial of a log again, and yield the differences between the records.

    If the plant cannot be simulated again, that is the only difference. If the trial takes too
    long, one `Unchecked` is yielded and nothing is compared.
    """
    sink = RecordCollector(computing_s() + 2 * limits.seconds_limit())
    try:
        with ready_trial(log.spec, log.start.trial, [Encoder(sink)], sink.interrupt) as trial:
            trial.run()
    except (TetractlError, ValueError, OverflowError) as error:
        reason = str(error).partition("\n")[0]
        yield Difference(None, "plant", f"cannot be simulated again: {reason}")
        return
    if sink.is_late:
        message = f"not compared, because this would take over {2 * limits.seconds_limit():g} s"
        yield Unchecked(
            None, "records", f"{message}; with {limits.FACTOR_VARIABLE}=2, twice as much is allowed"
        )
        return
    repeated = RawLog(raw_log.path, records=sink.records, library=WRITER)
    yield from log_differences(repeated, raw_log)
