"""Verify a log, by repeating its simulation or the decisions of its controller.

First, the end of the trial is checked (`EndCheck`). If a simulation was run again and gave the same
records, each of its decisions is thereby confirmed. For any other log, the decisions are computed
again from its frames (`recompute`). Then the records of the log are compared with each other
(`_differences_of_records`): the plant, consecutive numbers, digests, and damage.

If another machine or version wrote the log, costs must agree within a tolerance.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum, StrEnum
from pathlib import Path

from tetractl.control.methods.build import warm_up
from tetractl.core.commands import Command
from tetractl.core.errors import TetractlError
from tetractl.core.plan import Outcome
from tetractl.core.shown import NotebookDisplay
from tetractl.log import provenance
from tetractl.log.read.raw_log import ALTERED_TEXT, RawLog
from tetractl.log.read.reader import trial_of
from tetractl.log.read.salvage import scan
from tetractl.log.read.trial_log import TrialLog, frame_gaps, step_gaps
from tetractl.spec.experiment import find_packages
from tetractl.tools.table.terminal_table import LISTED_MAX
from tetractl.verification import run_again
from tetractl.verification.comparison import Difference, Unchecked, first_difference
from tetractl.verification.recompute import RELATIVE_TOLERANCE, Recomputed, recompute
from tetractl.verification.result_check import result_differences

BIT_DECIDING_FACTS = (
    "machine",
    "numba_settings",
    "code",
    "python",
    "numpy",
    "numba",
    "llvmlite",
)
"""Facts about a host that must agree, so that results have the same bits."""


class Method(StrEnum):
    """The method by which the decisions of a log are checked; see `recompute`."""

    RECOMPUTED = "re-computed, bit-identical"
    REEVALUATED = f"costs of the logged plans re-evaluated, to {RELATIVE_TOLERANCE:g}"


class EndCheck(Enum):
    """The method by which the end of a trial is checked."""

    NOTHING = (
        "not checked, because the log is damaged or has no result, or its spec names another plant"
    )
    RECORDS = (
        "checked against the steps, frames and poses in the log, because the plant is a lab, or a "
        "simulation that cannot be repeated"
    )
    AGAIN = "checked by running the simulation again"


@dataclass(frozen=True, slots=True)
class Verification(NotebookDisplay):
    """The result of verifying one log: whether its decisions follow from its data.

    Attributes:
        log: The log.
        rewritten: Program that wrote the file again from a log of tetractl. Empty if none did.
        steps: Number of control steps.
        checked: Number of steps whose repeated decision agrees with the log.
        method: How decisions were checked. REEVALUATED only if `elsewhere` names a difference.
        elsewhere: Differences between the host that wrote the log and this one.
        problems: Contradictions and other faults. The first decision that differs comes first.
        unchecked: Parts that were not compared, because that would take too long.
        notes: Further remarks.
        seconds: Time that the check took [s].
    """

    log: str
    rewritten: str
    steps: int
    checked: int
    method: Method
    elsewhere: tuple[str, ...]
    problems: tuple[Difference, ...]
    unchecked: tuple[Difference, ...]
    notes: tuple[str, ...]
    seconds: float

    @property
    def ok(self) -> bool:
        """Whether the log was checked to its end, and no problem was found.

        Notes are not problems.
        """
        return not (self.problems or self.unchecked)

    @property
    def verdict(self) -> str:
        """The verdict in words: "ok", "FAILED", or that the check did not reach the end."""
        if self.problems:
            return "FAILED"
        return "not checked to the end" if self.unchecked else "ok"

    @property
    def lines(self) -> Iterator[str]:
        """The lines of the report about the log: its verdict, the check that was made, problems."""
        verdict = self.verdict
        if self.rewritten:
            verdict += f", written again by {self.rewritten}"
            if self.ok:
                verdict += ": the same messages"
        decisions = f"{self.checked} of {self.steps} decisions {self.method}"
        yield f"{self.log}: {verdict}: {decisions} ({self.seconds:.2f} s)"
        if self.method is Method.REEVALUATED:
            yield from (f"  written elsewhere: {line}" for line in self.elsewhere)
        yield from (f"  {unchecked}" for unchecked in self.unchecked)
        for problem in self.problems[:LISTED_MAX]:
            yield f"  {problem}"
        if len(self.problems) > LISTED_MAX:
            yield f"  and {len(self.problems) - LISTED_MAX} more"
        yield from (f"  note: {note}" for note in self.notes)


def verify(path: Path, announce: Callable[[str], None] = lambda text: None) -> Verification:
    """Verify one log: compute its decisions again, and compare them with the logged ones.

    Args:
        path: File of the log.
        announce: Called with a message if code must be compiled first, as by `warm_up`.

    Raises:
        LogError: If nothing in the file can be read.
    """
    raw_log = scan(path)
    log = trial_of(raw_log)
    with suppress(TetractlError):  # that the controller cannot plan is found below
        warm_up(log.experiment, announce)
    began_s = time.perf_counter()
    elsewhere = host_differences(log)
    why_not_again = run_again.why_not_again(log, elsewhere)
    end_check = _choose_end_check(log, why_not_again)
    end_differences = list(_differences_of_end(end_check, raw_log, log))
    method = Method.RECOMPUTED
    decisions = Recomputed(len(log.steps), None)
    is_repeated = end_check is EndCheck.AGAIN and not end_differences
    if not is_repeated:
        method, decisions = _check_decisions(log, elsewhere)
    differences = [] if decisions.difference is None else [decisions.difference]
    differences += end_differences
    differences += _differences_of_records(raw_log, log)
    unchecked = tuple(difference for difference in differences if isinstance(difference, Unchecked))
    notes = list(_notes(raw_log, log))
    if end_check is EndCheck.RECORDS and log.start.plant.simulated:
        notes.append(f"the trial was not run again, because {why_not_again}")
    return Verification(
        log=str(path),
        rewritten=raw_log.rewritten_by,
        steps=len(log.steps),
        checked=decisions.agreeing_steps,
        method=method,
        elsewhere=elsewhere,
        problems=tuple(
            difference for difference in differences if not isinstance(difference, Unchecked)
        ),
        unchecked=unchecked,
        notes=tuple(notes),
        seconds=time.perf_counter() - began_s,
    )


def _check_decisions(log: TrialLog, elsewhere: tuple[str, ...]) -> tuple[Method, Recomputed]:
    """Check the decisions of a log, and return the method that was used and the result.

    The searches are repeated first, even if another computer wrote the log. If no decision differs,
    this is the stricter check. Otherwise, the differences `elsewhere` between the computers may be
    the cause, so the logged searches are only evaluated.
    """
    decisions = recompute(log, search_again=True)
    if decisions.difference is None or not elsewhere:
        return Method.RECOMPUTED, decisions
    return Method.REEVALUATED, recompute(log, search_again=False)


def _choose_end_check(log: TrialLog, why_not_again: str) -> EndCheck:
    """Choose how the end of a trial is checked: by the first row of EndCheck that applies.

    `why_not_again` is the reason why a simulation cannot be run again, or "" if it can.
    """
    is_simulated = log.start.plant.simulated
    is_disputed = is_simulated != log.experiment.plant.simulated
    if is_disputed or log.damage is not None or log.result is None:
        return EndCheck.NOTHING
    return EndCheck.RECORDS if why_not_again else EndCheck.AGAIN


def _differences_of_end(check: EndCheck, raw_log: RawLog, log: TrialLog) -> Iterator[Difference]:
    """Yield each contradiction in the end of a trial, found by the given check.

    Nothing is yielded for NOTHING, or if the log has no result.
    """
    result = log.result
    if check is EndCheck.NOTHING or result is None:
        return
    if log.stop is None:
        yield Difference(None, "stop", "is missing, because /commands contains no stop")
    if result.outcome is Outcome.ABORTED and not result.reason:
        yield Difference(
            None, "result.reason", "says that the trial was aborted, but gives no reason"
        )
    if check is EndCheck.AGAIN:
        yield from run_again.differences(raw_log, log)
    else:
        yield from result_differences(log, result)


def _differences_of_commands(log: TrialLog) -> Iterator[Difference]:
    """Yield the first contradiction between a step's command and its plan, or /commands.

    Every command but the last also affects the next decision, which is computed again. Commands may
    be missing from the channel of a damaged log.
    """
    commands_by_time: dict[int, list[Command]] = {}
    for command in log.commands:
        commands_by_time.setdefault(command.sent_ns, []).append(command)
    for step in log.steps:
        action = step.command.action
        difference = first_difference(step.plan.action, action, name="command.action")
        simultaneous = commands_by_time.get(step.command.sent_ns, [])
        if difference is None and (simultaneous or log.damage is None):
            channel_differences = [first_difference(step.command, other) for other in simultaneous]
            if None not in channel_differences:
                difference = Difference(None, "command", "differs from the commands on /commands")
        if difference is not None:
            yield difference.in_step(step.k)
            return


def _differences_of_records(raw_log: RawLog, log: TrialLog) -> Iterator[Difference]:
    """Yield contradictions between the records of a log.

    For example, run and spec may name different plants, frames or steps may be missing, or digests
    may not match. Damage is also yielded.
    """
    if log.start.plant.simulated != log.experiment.plant.simulated:
        yield Difference(None, "run.mode", "differs from the plant of the spec")
    if not _may_lose_frames(log):
        for gap in frame_gaps(log):
            yield Difference(None, "frames", f"missing: {gap}")
    for gap in step_gaps(log):
        yield Difference(gap.first_number, "k", f"missing: {gap}")
    yield from _differences_of_commands(log)
    if raw_log.altered:
        yield Difference(None, "content_digest", ALTERED_TEXT)
    if log.damage is not None:
        for message in (*log.damage.problems, *(f"lost: {lost}" for lost in log.damage.lost)):
            yield Difference(None, "damage", message)
    elif raw_log.host_altered:  # records of the host may be lost in a damaged log
        message = "the records of the host do not match the digest that the log states"
        yield Difference(None, "host_digest", message)


def _notes(raw_log: RawLog, log: TrialLog) -> Iterator[str]:
    """Yield remarks that a reader of the log should know, but that are not faults."""
    if _may_lose_frames(log):
        for gap in frame_gaps(log):
            yield f"missing: {gap}"
    if raw_log.reordered:
        yield "the content digest was not compared, because the messages are in another order"


def _may_lose_frames(log: TrialLog) -> bool:
    """Check whether the camera itself may have lost the missing frames."""
    return log.experiment.plant.loses_frames and log.damage is None


def host_differences(log: TrialLog) -> tuple[str, ...]:
    """List the differences between the log's computer and this computer that may change results.

    The differences concern the processor, versions and the packages of the spec. The result is
    empty if nothing differs.
    """
    plugin_versions = provenance.plugins(find_packages(log.experiment))
    present_facts = {**provenance.host(), **provenance.versions(), **plugin_versions}
    return tuple(
        _describe_host_difference(key, log.facts.get(key), present_facts.get(key))
        for key in (*BIT_DECIDING_FACTS, *plugin_versions)
        if present_facts.get(key) != log.facts.get(key)
    )


def _describe_host_difference(key: str, logged: str | None, present: str | None) -> str:
    """Describe how the fact `key` differs between the log's computer and this computer."""
    return (
        f"{key}: {logged or 'unknown'} on the computer that wrote the log, "
        f"{present or 'unknown'} on this one"
    )
