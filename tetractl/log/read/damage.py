"""Whether a log is whole, and what it lacks; no other module decides it.

A log is not whole if it is

    torn        records of the file cannot be read
    recovered   it was copied from a torn log, of which it has lost records
    unfinished  it has no result, or one that tetractl does not write
    altered     its records do not match the digests that it states

The first three are known once the records are found. That a log is altered is known only once all
its records have been hashed, which takes longer. Numbers of camera frames or control steps that are
missing are no damage by themselves: a camera of a lab may lose frames.
"""

from tetractl.log.read.raw_log import ALTERED, RawLog
from tetractl.log.read.trial_log import Damage, TrialLog, frame_gaps, step_gaps


def is_damaged(raw: RawLog) -> bool:
    """Return whether a log is torn, recovered or unfinished."""
    return bool(raw.problems) or raw.recovered is not None or raw.result is None


def damage_of(raw: RawLog, until_s: float) -> Damage | None:
    """Return how a log is torn, recovered and unfinished, None if it is none of these; its last
    frame was received at `until_s` [s].
    """
    if not is_damaged(raw):
        return None
    problems: list[str] = []
    lost: list[str] = []
    if raw.recovered is not None:
        problems += raw.recovered.problems
        lost += raw.recovered.lost
    problems += raw.problems
    lost += raw.lost
    if raw.result is None:
        problems.append(raw.why_no_result)
        lost.append(f"the result and everything after {until_s:.3f} s")
    return Damage(tuple(problems), tuple(lost))


def with_alteration(raw: RawLog, damage: Damage | None) -> Damage | None:
    """Return the damage of a log, with the problem that it is altered, if it is."""
    if not raw.altered:
        return damage
    before = damage or Damage((), ())
    return Damage((*before.problems, ALTERED), before.lost)


def losses(raw: RawLog, trial: TrialLog) -> tuple[str, ...]:
    """Return what a log has lost: nothing if its records match both digests that it states, unless
    its source had lost something.
    """
    lost = trial.damage.lost if trial.damage else ()
    if trial.digest and not raw.altered and not raw.host_altered:
        return lost if raw.recovered else ()
    gaps = [*frame_gaps(trial), *step_gaps(trial)]
    lost += tuple(map(str, gaps))
    if trial.stop is None:
        lost += ("the stop at the end",)
    return lost or ("a record covered by the log's digest or its host digest",)
