"""That each fault has ended the trial in its time, and that a trial begins and ends at rest."""

import math
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from tetractl.core.plan import Outcome
from tetractl_emulator.rehearsal.due import FRAME_S, WHEEL, Due, Fields
from tetractl_emulator.rehearsal.truth import Truth
from tetractl_emulator.rehearsal.violation import AIR_S, SLACK_S, Violation

OFF_S, OFF_BLOCKS, OFF, BLOCK_S = 2.0, 83, 0.05, 0.05  # 83 blocks show a wheel 5 % beyond its limit
KNOWN_S, TURNS_S, TURNS_RAD_S = 3.0, 0.6, 0.5  # of driving, after which wheels explain no such turn
STEADY_S = 0.3  # delay of a command, within which motion may be that of the one before
GAP_S = 0.5  # longest time without a frame
RESTS_S = 1.05  # longest time over which a line is fitted to poses at rest, and a frame
SOON_S = 0.3  # after which a line shows plain motion through a motion-capture system's noise
STOPPING_S = 0.2  # for which stops are sent, before it is looked whether robots rest
PLAIN_MM_S, PLAIN_RAD_S = 10.0, 0.1  # five times what counts as motion at rest


def times(truth: Truth, stale_s: float, untracked_s: float) -> Iterator[Violation]:
    """Yield what ended too late, or began or ended in motion."""
    yield from late(truth)
    yield from _off(truth)
    yield from _turns(truth)
    yield from seldom(truth, stale_s, 3.0 * untracked_s)
    yield from _at_rest(truth)


def late(truth: Truth) -> Iterator[Violation]:
    """Yield the faults that did not end the trial in their time while robots were driven."""
    for began, ended, fault in truth.faults:
        due, name = truth.day.plan.kind(fault).due, str(fault["kind"])
        if due is None or (due.alone and truth.day.plan.off):
            continue
        if fault["fault"] == "host_clock" and began < truth.began_s:
            asked_s = truth.first("client")
            if not truth.dated or began <= asked_s < math.inf:
                continue  # no other clock shows it, or none had been read: it harms nothing
        hides = fault["fault"] != "repeat" and truth.met("repeat")  # what else there is to see
        if due.seen and (hides or truth.met("clock_jump", "clock_rate")):
            continue
        speeds = truth.setup.speed * truth.setup.metres * 1000
        i = truth.setup.names.index(fault["robot"]) if "robot" in fault else 0
        within = due.within_s(fault, float(speeds[i]))
        for since, until in () if math.isnan(within) else _spans(truth, due, i, began, ended):
            allowed = within + AIR_S + truth.napped_s * (name != "host busy")
            others = sum(at < since + allowed for at, _, _ in truth.faults) - 1
            if until - since > allowed and not (due.alone and others):
                found = f"{name}: {until - since:.2f} s, allowed {within:.2f}"
                yield Violation("late", since, found)
                break


def _off(truth: Truth) -> Iterator[Violation]:
    """A wheel that is slower from the start, without another fault, is named in time."""
    plan = truth.day.plan
    if not plan.slower or "actuator" not in plan.emulation:
        return
    blocks = 4 * OFF_BLOCKS * (OFF / (plan.slower - WHEEL)) ** 2
    allowed = max(OFF_S, blocks * BLOCK_S) + BLOCK_S + AIR_S  # once the last block has ended
    for since, until in truth.driven[:1]:
        steps = [(one, two) for one, two in pairwise(truth.sent(0)) if since <= one[0] < until]
        ahead_s = sum(two[0] - one[0] for one, two in steps if one[1])
        if ahead_s > allowed and not any(at < since + allowed for at, _, _ in truth.faults):
            found = f"a wheel slower by {plan.slower:.0%}: {ahead_s:.2f} s, allowed {allowed:.2f}"
            yield Violation("late", since, found)


def _turns(truth: Truth) -> Iterator[Violation]:
    """A pose that turns by itself ends the trial in time once the wheels are known."""
    for began, ended, fault in truth.faults if not truth.day.plan.off else ():
        turn = abs(fault.get("turn", 0.0)) / FRAME_S
        if fault["fault"] != "ghost" or turn < TURNS_RAD_S or any(fault["by"]):
            continue
        for since, until in truth.driven:
            late = min(until, ended) - truth.sight_s(until) > began + TURNS_S + AIR_S
            others = sum(at < began + TURNS_S + AIR_S for at, _, _ in truth.faults) > 1
            if late and since + KNOWN_S < began < until and not others:
                yield Violation("late", began, f"turns by {turn:.2f} rad/s: {until - began:.2f} s")


def _spans(
    truth: Truth, due: Due, i: int, began: float, ended: float
) -> Iterator[tuple[float, float]]:
    """Yield the times of a fault in which the guard let robots be driven, as `due` counts them."""
    for since, until in truth.driven:
        since, until = max(since, began), min(until, ended)
        if due.steady:
            since, until = _steady(truth, i, since, until)
        if until > since:
            yield since, until - (truth.sight_s(until) if due.seen else 0.0)


def _steady(truth: Truth, i: int, since: float, until: float) -> tuple[float, float]:
    """Return since when robot i was driven ahead for `STEADY_S`, and when it turned on the spot."""
    from_s, ahead_s = math.inf, math.inf
    for at, ahead, turns in truth.sent(i):
        if at >= until:
            break
        if turns and from_s < math.inf:
            return from_s, at
        if from_s == math.inf:
            ahead_s = min(ahead_s, at) if ahead else math.inf
            if at - ahead_s >= STEADY_S and at >= since:
                from_s = max(since, ahead_s + STEADY_S)
    return from_s, until


def seldom(truth: Truth, stale_s: float, most_s: float) -> Iterator[Violation]:
    """The time for which a robot was not shown, less a quarter of the time shown, is bounded."""
    if truth.met("late_frames", "reordered", "clock_jump", "clock_rate", *NAPS):
        return
    total, then = np.zeros(len(truth.setup.names)), -math.inf
    active = np.zeros(len(truth.times), dtype=bool)
    for since, until in truth.driven:
        active |= (truth.times >= since) & (truth.times < until)
    for at, unseen, drives in zip(truth.times, truth.unseen, active, strict=True):
        if drives:
            passed = min(at - then, 2 * FRAME_S)
            total = np.maximum(0.0, total + np.where(unseen > stale_s, passed, -passed / 4))
        then = at
        if (total > most_s + GAP_S).any():
            name = truth.setup.names[int(total.argmax())]
            yield Violation("seen too rarely", float(at), name)
            return


NAPS = ("stopped", "host_clock")


def _moves(fault: Fields) -> bool:
    """Return whether a fault shows robots plainly in motion."""
    if fault["fault"] != "ghost" and not (fault["fault"] == "picture" and fault.get("creeps")):
        return False
    turn, way = fault.get("turn", 0.0), math.hypot(*fault.get("by", (0.0, 0.0)))
    return way / FRAME_S > PLAIN_MM_S or abs(turn) / FRAME_S > PLAIN_RAD_S


def _at_rest(truth: Truth) -> Iterator[Violation]:
    """No run begins while robots are shown in motion; none counts unless they are seen to rest."""
    run = truth.first("run")
    moving = [(began, ended, f["kind"]) for began, ended, f in truth.faults if _moves(f)]
    clear = "noise_mm" in truth.day.plan.emulation.get("camera", {})
    alone = sum(began < run for began, _, _ in truth.faults) == 1
    for began, ended, kind in moving:
        if began + (SOON_S if clear and alone else RESTS_S) < run < ended:
            yield Violation("begins in motion", run, kind)
    log = truth.trial
    if log is None or log.result is None or log.result.outcome == Outcome.ABORTED:
        return
    for began, ended, kind in moving:
        if began < truth.ended_s + STOPPING_S and ended > truth.alive_s:
            yield Violation("ends in motion", truth.alive_s, kind)
    unseen = truth.unseen[truth.times <= truth.alive_s][-1:]
    if len(unseen) and unseen.max() > GAP_S:
        yield Violation("ends unseen", truth.alive_s, f"{unseen.max():.2f} s")
    pressed = truth.first("fault", name="emergency", phase="start")
    if run < pressed < truth.alive_s - SLACK_S:
        yield Violation("late", pressed, "an emergency stop, and the trial counts")
