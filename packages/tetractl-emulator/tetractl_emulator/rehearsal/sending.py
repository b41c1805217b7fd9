"""What our side sends: no drive without sight, only stops after a stop, and as often as it must."""

from collections.abc import Iterator

import numpy as np

from tetractl.experiment.lab_section import UNTRACKED_STOP_S, LabLimits
from tetractl_emulator.rehearsal.truth import EMERGENCY, Truth
from tetractl_emulator.rehearsal.violation import SLACK_S, Violation

STOPS, STOPS_S = 10, 0.25  # stops after a run, and the time of ten, 20 ms apart, and a tick
SPREAD_S = 0.17  # least time that they take, so that one disturbance does not hit all
REPEAT_S = 0.5 + 0.05 + 0.02  # from a stop to its repetition: the wait, a poll, and the stop's gap
QUARTER_S, SOME = 0.25, 40  # commands are counted in each quarter of a second, if there are so many
TICK_S = 0.004  # within which commands of one tick of our side are sent
MUTE = ("unplug", "stuck_port", "stopped", "host_clock")  # nothing can be sent


def sending(truth: Truth, limits: LabLimits, watchdog_s: float) -> Iterator[Violation]:
    """Yield what is wrong with the commands sent."""
    yield from _commands(truth, limits)
    yield from _evenly(truth)
    if not truth.met(*MUTE) and not truth.killed:
        yield from _often(truth, watchdog_s)
        yield from _repeated(truth)
    yield from _robots(truth, watchdog_s)


def _commands(truth: Truth, limits: LabLimits) -> Iterator[Violation]:
    """Drive commands need a new sight of each robot; after a stop only stops are sent."""
    waited_s = 0.0 if truth.dated else max(truth.napped_s, truth.late_s)
    all_s = limits.stale + SLACK_S + waited_s + truth.repeats_s(limits.wheel_error)
    one_s = all_s + UNTRACKED_STOP_S
    emergency = truth.first("fault", name="emergency", phase="start") + SLACK_S
    commands = truth.of("command")
    for command, after in zip(commands, [*commands[1:], *commands[-1:]], strict=True):
        at = command["t_ns"] / 1e9
        driven = truth.drives(command)
        if at > emergency and not command["flags"] & EMERGENCY and at > truth.first("run"):
            yield Violation("emergency released", at, f"flags {command['flags']}")
            return
        # a plan may begin after a rest in the tick in which the run ends for another reason
        stops = not any(truth.drives(after)) and after["t_ns"] / 1e9 < at + TICK_S
        at_once = stops and at < truth.abort_s
        if any(driven) and at > truth.ended_s + TICK_S and not at_once:
            yield Violation("drives after stop", at, f"{at - truth.ended_s:.3f} s after the stop")
            return
        unseen = truth.unseen_at(command)
        blind = [u for u, drives in zip(unseen, driven, strict=False) if drives]
        most_s = min(one_s, min(unseen, default=0.0) + UNTRACKED_STOP_S + SLACK_S)
        if blind and (max(blind) > most_s or min(unseen) > all_s):
            yield Violation("drives blind", at, f"unseen for {max(blind):.3f} s")
            return


def _often(truth: Truth, watchdog_s: float) -> Iterator[Violation]:
    """Commands feed the watchdog even if every second one is lost; ten stops follow each run, and
    an emergency stop is sent whenever it is pressed.
    """
    pressed = truth.first("fault", name="emergency", phase="start")
    flagged = [c["t_ns"] / 1e9 for c in truth.of("command") if c["flags"] & EMERGENCY]
    sent_s = min((at for at in flagged if at > pressed - SLACK_S), default=np.inf)
    if truth.first("run") < pressed < truth.alive_s - SLACK_S and sent_s > pressed + SLACK_S:
        yield Violation("emergency not sent", pressed, "no latched stop in time")
    sent = truth.commanded
    for since, until in truth.driven:
        during = [since, *sent[(sent > since) & (sent < until)], min(until, truth.alive_s)]
        gaps = np.diff(during)
        if gaps.max() > watchdog_s / 2:
            found = f"for {gaps.max():.3f} s"
            yield Violation("silent", float(during[int(gaps.argmax())]), found)
            return
        still = [c for c in truth.of("command") if not any(truth.drives(c))]
        stops = [c for c in still if until - 0.004 <= c["t_ns"] / 1e9 <= until + STOPS_S]
        if len(stops) < STOPS and until + STOPS_S < truth.alive_s:
            yield Violation("stops", until, f"{len(stops)} in {STOPS_S} s")
            return
        if stops and (took := (stops[-1]["t_ns"] - stops[0]["t_ns"]) / 1e9) < SPREAD_S:
            yield Violation("stops", until, f"all {len(stops)} within {took:.3f} s")
            return


def _evenly(truth: Truth) -> Iterator[Violation]:
    """In no quarter of a second are more than twice as many commands sent as in most: a radio would
    queue them.
    """
    at = truth.commanded
    during = [at[(at >= since) & (at < until)] for since, until in truth.driven]
    sent = np.concatenate([at[:0], *during])
    counts = np.searchsorted(sent, sent + QUARTER_S) - np.arange(len(sent))
    if len(sent) > SOME and counts.max() > 2 * (most := np.median(counts)):
        found = f"{counts.max()} in {QUARTER_S} s, {most:.0f} in most"
        yield Violation("too often", float(sent[counts.argmax()]), found)


def _repeated(truth: Truth) -> Iterator[Violation]:
    """While one robot is not shown, stops are at most half a second apart, for two seconds. They
    may begin again within: a run that is paused first, and ends once the robots stand.
    """
    sent = truth.commanded
    until = min(truth.ended_s + 2.0, truth.alive_s)
    apart = truth.unseen.max(axis=1) - truth.unseen.min(axis=1) > 2 * UNTRACKED_STOP_S
    held_s = truth.times - np.maximum.accumulate(np.where(apart, -np.inf, truth.times))
    late = (truth.times > truth.ended_s + 0.85) & (truth.times < until)
    for at in truth.times[late & (held_s > REPEAT_S)]:
        if not ((sent > at - REPEAT_S) & (sent <= at)).any():
            yield Violation("stops", float(at), "not repeated while a robot is not shown")
            return


def _robots(truth: Truth, watchdog_s: float) -> Iterator[Violation]:
    """A robot that has latched stays latched; one that heard a stop obeys no older command."""
    latched, stood = truth.status(2), ~truth.status(1) & ~truth.status(4)
    if truth.met("off"):
        return
    for i, name in enumerate(truth.setup.names):
        freed = np.flatnonzero(latched[:-1, i] & ~latched[1:, i])
        if len(freed):
            yield Violation("emergency released", float(truth.times[freed[0]]), name)
        rows = np.flatnonzero(stood[:, i] & (truth.times > truth.ended_s + SLACK_S))
        again = truth.status(1)[:, i]
        for row in rows[:1]:
            soon = again[row:] & (truth.times[row:] < truth.times[row] + watchdog_s)
            if soon.any():
                yield Violation("obeys an old command", float(truth.times[row]), name)
