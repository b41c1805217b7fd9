"""How soon the guard stops robots that a camera shows elsewhere than they are; all emulated.

    python benchmarks/guard.py                    what a camera may show, in two plays each
    python benchmarks/guard.py --plays 1 along    one play of some
    python benchmarks/guard.py --slow --plays 3   poses that leave slowly, from the start and later
    python benchmarks/guard.py --rate 30          frames as seldom as an AprilTag camera's
    python benchmarks/guard.py --slip --plays 6   a pose that turns only while its robot drives
    python benchmarks/guard.py --culprits         what the reasons name, in two plays each
    python benchmarks/guard.py --alarms 1000      the same trials with nothing wrong
    python benchmarks/guard.py --batches 4        batches with a pose that turns in one trial

Three m3pi robots drive by model predictive control in the emulated lab, in virtual time, before a
camera with noise of 0.3 mm and 4 mrad; each wheel is up to 10 % off, and 5 % of the
packets are lost. What the emulator's `tests/support/ghosts.py` shows begins 0.6 to 2.1 s after the
first command, exchanged numbers with it.

Worst of the plays: how far off its robot the pose shown was when that robot was commanded to stop
[mm], how long after the fault that was and all robots stood [s], how far one drove until then
[mm], and how many frames later the pose was accepted after all. A play is ended after 5 s.
"""

import argparse
import math
import re
import sys
from collections import Counter
from functools import partial
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / folder) for folder in ("tests", "packages/tetractl-emulator/tests")]

from support.bench_agreement import lab_spec  # noqa: E402
from support.ghosts import (  # noqa: E402
    CAMERA,
    CAMERA_HZ,
    KINDS,
    NUMBERS,
    Ghost,
    slow_radio,
    trial_of,
)
from support.virtual_lab import VirtualLab  # noqa: E402

from tetractl.core.errors import AbortError  # noqa: E402
from tetractl.lab.drift_check import LIMIT  # noqa: E402
from tetractl.log.read.trial_log import Origin, ResultSummary  # noqa: E402
from tetractl.results.turning import turned_otherwise  # noqa: E402

SPEEDS = (0.05, 0.1, 0.2, 0.4)  # m/s
SLOW = {  # what the long check is for
    "turn": (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.6, 1.0, 1.25),  # rad/s
    "along": (0.003, 0.01, 0.03, 0.1),
    "against": (0.003, 0.01, 0.03, 0.1),
    "sideways": (0.003, 0.01, 0.03, 0.1),
    "origin": (0.003, 0.01),
    "scale": (0.003, 0.01),  # 1/s
    "rotation": (0.0087, 0.035),  # rad/s
}
NOTICED = ("another body", "all robots drift", "does not move", "backward", "the wrong way")
NEAR = ("too close", "about to leave", "about to enter")
"""What a guard says of robots that truly come near to another, the edge or an obstacle."""
REFUSED = "refused: "
UNITS = {"turn": "rad/s", "scale": "/s", "rotation": "rad/s"}
ALL = (0, 1, 2)
CULPRITS = (  # what happens, its size, to whom, what it is, and the right thing to name
    ("origin", 0.03, ALL, "the origin moves, 30 mm/s", "camera"),
    ("origin", 0.1, ALL, "the origin moves, 100 mm/s", "camera"),
    ("push", 0.015, ALL, "the origin moves by 15 mm", "camera"),
    ("push", 0.025, ALL, "the origin moves by 25 mm", "camera"),
    ("rotation", 0.1, ALL, "the picture turns, 0.1 rad/s", "camera"),
    ("radio", 0.35, ALL, "the radio is 0.35 s late", "radio"),
    ("radio", 0.5, ALL, "the radio is 0.5 s late", "radio"),
    ("turn", 0.3, (0,), "one pose turns, 0.3 rad/s", "robot"),
    ("turn", 0.6, (0,), "one pose turns, 0.6 rad/s", "robot"),
    ("along", 0.03, (0,), "one pose moves along, 30 mm/s", "robot"),
    ("sideways", 0.03, (0,), "one pose moves sideways, 30 mm/s", "robot"),
    ("steps", 0.0, (0,), "one pose moves by 4 mm each 0.5 s", "robot"),
    ("push", 0.012, (0,), "one robot is pushed by 12 mm", "robot"),
    ("push", 0.015, (0,), "one robot is pushed by 15 mm", "robot"),
    ("push", 0.025, (0,), "one robot is pushed by 25 mm", "robot"),
    (NUMBERS, 0.0, (0, 1), "green and blue exchange numbers", "numbers"),
    (NUMBERS, 0.0, (0, 2), "green and red exchange numbers", "numbers"),
    (NUMBERS, 0.0, (1, 2), "blue and red exchange numbers", "numbers"),
)
NAMED = {
    "camera": "all robots (drift together|are seen to move)",
    "radio": "is the radio slow",
    "numbers": "as the other is commanded",
    "robot": "(green|blue|red)(.s left wheel| moves| does not move| turns| still moves)",
}
BATCH = 12  # trials of a batch
SLIPS = (0.1, 0.2)  # of a pose while its robot drives [rad/s]
TURNS = (0.05, 0.1, 0.15, 0.2)  # of a pose in one trial of a batch [rad/s]
TAIL = 5.0  # statistic above which the tail of good trials is fitted


def ghosts(kind: str) -> None:
    """Print a row for each speed of a kind, or for one and for all robots."""
    ways = [(0.0, (0,)), (0.0, ALL)] if kind == "frozen" else [(speed, (0,)) for speed in SPEEDS]
    for speed, who in ways:
        plays = [
            Ghost(kind, speed, who, at_s=0.6 + 1.5 * k / max(1, PLAYS - 1)) for k in range(PLAYS)
        ]
        reasons = [trial_of(play.haunt, k, RATE_HZ).reason for k, play in enumerate(plays)]
        off = max(play.off_mm for play in plays)
        held = max(play.held_s for play in plays)
        rest = max(play.rest_s for play in plays)
        driven = max(play.driven_mm for play in plays)
        noticed = sum(reason != "not noticed" for reason in reasons)
        late = sum(sum(play.late) for play in plays)
        robots = "all" if who == ALL else "one"
        what = robots if kind == "frozen" else f"{speed:g} m/s"
        print(
            f"| {kind} | {what} | {noticed} of {len(plays)} | {off:.0f} | {held:.2f} | {rest:.2f} "
            f"| {driven:.0f} | {late} |",
            flush=True,
        )


def is_noticed(reason: str, *more: str) -> bool:
    """Whether the reason for which a trial ended is that poses are false, or one of `more`."""
    return any(text in reason for text in (*NOTICED, *more))


def slow(kind: str) -> None:
    """Print a row for each rate of a slow kind: plays from before the start on, from the first
    command on, and from later on.
    """
    for rate in SLOW[kind]:
        cells: list[str] = []
        for begins in ([-math.inf], [0.0], [0.6, 1.35, 2.1]):
            plays = [
                Ghost(kind, rate, ALL if kind in CAMERA else (k % 3,), at_s=at_s, limit_s=60.0)
                for at_s in begins
                for k in range(PLAYS if len(begins) == 1 else -(-PLAYS // 3))
            ]
            reasons = [reason_of(play, k) for k, play in enumerate(plays)]
            rest = [bool(re.search("still moves|move alike", reason)) for reason in reasons]
            drove = [is_noticed(reason) for reason in reasons]
            if begins == [-math.inf]:
                refused = sum(reason.startswith(REFUSED) for reason in reasons)
                cells.append(f"{refused} of {len(plays)}")
                continue
            for track in (drove, rest):
                offs = [play.off_mm for play, yes in zip(plays, track, strict=True) if yes]
                said = sum(yes and "all robots" in r for yes, r in zip(track, reasons, strict=True))
                camera = f", {said} camera" * (kind in CAMERA and len(offs) > 0)
                cells += [f"{len(offs)} of {len(plays)}{camera}", f"{max(offs, default=0):.0f}"]
        print(f"| {kind} | {rate:g} {UNITS.get(kind, 'm/s')} | {' | '.join(cells)} |", flush=True)


def slips() -> None:
    """Print a row for each rate at which a pose turns only while its robot drives, from the first
    command on: how trials ended, and how far the pose was off its robot then.
    """
    for rate in SLIPS:
        plays = [Ghost("slip", rate, (k % 3,), at_s=0.0, limit_s=60.0) for k in range(PLAYS)]
        results = [trial_of(play.haunt, k, RATE_HZ) for k, play in enumerate(plays)]
        times_s = list[float]()
        stopped = list[float]()
        for play, result in zip(plays, results, strict=True):
            if result.outcome.complete:
                times_s.append(play.off_mm)
            elif is_noticed(result.reason, "still moves"):
                stopped.append(play.off_mm)
            print(result.summary, f"{play.off_mm:.0f} mm off", file=sys.stderr, flush=True)
        not_stopped = PLAYS - len(times_s) - len(stopped)
        print(
            f"| {rate:g} | {len(stopped)} of {PLAYS} | {max(stopped, default=0):.0f} "
            f"| {not_stopped} of {PLAYS} | {len(times_s)} of {PLAYS} "
            f"| {max(times_s, default=0):.0f} |",
            flush=True,
        )


def reason_of(play: Ghost, trial: int) -> str:
    """Run a trial with a ghost; return why it was aborted or did not start."""
    try:
        return trial_of(play.haunt, trial, RATE_HZ).reason
    except AbortError as refused:
        return REFUSED + str(refused)


def culprits() -> None:
    """Print a row for each of CULPRITS: what the reasons name, how far off a pose was, and how far
    one robot drove, on average and at most.
    """
    for kind, size, who, what, right in CULPRITS:
        offs = [0.0]
        ways = list[float]()
        named = dict.fromkeys(NAMED, 0)
        for k in range(PLAYS):
            robots = (k % 3,) if who == (0,) else who
            at_s = 0.0 if kind == NUMBERS else 0.6 + 0.7 * k
            play = Ghost(kind, size, robots, at_s=at_s, limit_s=60.0)
            haunt = partial(slow_radio, delay_s=size) if kind == "radio" else play.haunt
            reason = trial_of(haunt, k, RATE_HZ).reason
            offs.append(play.off_mm)
            ways.append(play.driven_mm)
            for name, text in NAMED.items():
                named[name] += bool(re.search(text, reason))
        counts = " | ".join(f"{n}" if n else "" for n in named.values())
        none = PLAYS - sum(named.values())
        driven = "" if kind == "radio" else f"{sum(ways) / len(ways):.0f} / {max(ways):.0f}"
        print(
            f"| {what} | {right} | {counts} | {none or ''} | {max(offs):.0f} | {driven} |",
            flush=True,
        )


def watched(labs: list[VirtualLab], peaks: list[float], lab: VirtualLab) -> None:
    """Note a lab, and the greatest statistic of its drift check."""
    labs.append(lab)
    peaks.append(0.0)

    def look() -> None:
        peaks[-1] = max(peaks[-1], lab.plant.rig.loop.guard.drift.worst)

    lab.clock.steps.append(look)


def beyond(peaks: list[float]) -> float:
    """Return how many of 1,000 trials would exceed the limit, by the peaks above TAIL."""
    over = [peak - TAIL for peak in peaks if peak > TAIL]
    far = math.exp((TAIL - LIMIT) * len(over) / sum(over)) if over else 0.0
    return 1000 * len(over) / len(peaks) * far


def alarms(first: int, last: int) -> None:
    """Print each trial that did not end by itself or in which a pose was refused, and counts; of
    the drift check, the greatest statistic and how many of 1,000 trials would exceed its limit, if
    what is above TAIL falls off exponentially.
    """
    ended = refused = close = 0
    peaks: list[float] = []
    for trial in range(first, last):
        labs: list[VirtualLab] = []
        result = trial_of(partial(watched, labs, peaks), trial, RATE_HZ)
        guard = labs[0].plant.rig.loop.guard
        near = any(text in result.reason for text in NEAR)
        close += near
        ended += not result.outcome.complete and not near
        refused += guard.refusals > 0
        if guard.refusals or not result.outcome.complete:
            print(f"trial {trial}: {result.summary}, {guard.refusals} poses refused", flush=True)
        if trial == last - 1 or trial % 10 == 9:
            print(
                f"{trial + 1 - first} trials: {ended} false alarms, {refused} with refused poses, "
                f"{close} ended as robots came too near; statistic {max(peaks):.1f}, "
                f"{beyond(peaks):.2f} of 1,000 trials above {LIMIT:g}",
                flush=True,
            )


def trial_of_batch(batch: int, trial: int, rate: float = 0.0) -> ResultSummary:
    """Run a trial with the robots of a batch, in which the pose of one robot turns at a rate."""
    play = Ghost("turn", rate, (batch % 3,), at_s=0.0, limit_s=60.0)
    haunt = play.haunt if rate else lambda lab: None
    result = trial_of(haunt, trial, RATE_HZ, robots_of=batch)
    what = f"{rate:g} rad/s, {play.off_mm:.0f} mm off; " if rate else ""
    turns = zip(result.verdict.turn, result.verdict.turn_std, strict=True)
    said = ", ".join(f"{turn:+.3f} ± {error:.3f}" for turn, error in turns)
    print(f"batch {batch}, trial {trial}: {what}{result.summary}; {said} rad/s", flush=True)
    spec = lab_spec().experiment
    return ResultSummary(f"{trial}", spec, 0, trial, Origin.EMULATED, result, False, None)


def batches(first: int, last: int) -> None:
    """Print what `stats` marks in each batch, whose robots are those of the trial of its number:
    of BATCH trials in which nothing is wrong; and of the same trials, but for the one of the
    batch's number, in which the pose of one robot turns from the first command on.
    """
    stopped = Counter()
    alone = Counter()
    verdicts = Counter()
    n = last - first
    for batch in range(first, last):
        honest = [trial_of_batch(batch, trial) for trial in range(BATCH)]
        k = batch % BATCH
        verdicts[0.0] += len(turned_otherwise(honest))
        for rate in TURNS:
            false = trial_of_batch(batch, k, rate)
            marks = turned_otherwise([*honest[:k], false, *honest[k + 1 :]])
            noticed = is_noticed(false.result.reason, "still moves")
            if noticed:
                stopped[rate] += 1
            if false.log in marks:
                verdicts[rate] += 1
                if not noticed:
                    alone[rate] += 1
            verdicts[0.0] += sum(log != false.log for log in marks)
    print("| turn [rad/s] | stopped for it | marked | of those not stopped for it |")
    print("|--:|--:|--:|--:|")
    for rate in TURNS:
        counts = (stopped[rate], n), (verdicts[rate], n), (alone[rate], n - stopped[rate])
        print(f"| {rate:g} | {' | '.join(f'{these} of {total}' for these, total in counts)} |")
    print(f"{verdicts[0.0]} marks of trials in which nothing is wrong, {n * BATCH} trials")


parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
parser.add_argument("--plays", type=int, default=2, metavar="N")
parser.add_argument("--rate", type=float, default=CAMERA_HZ, help="camera frames a second")
parser.add_argument("--slow", action="store_true", help="poses that leave their robots slowly")
parser.add_argument("--slip", action="store_true", help="a pose that turns as its robot drives")
parser.add_argument("--culprits", action="store_true", help="what the reasons name")
parser.add_argument("--alarms", type=int, metavar="N", help="trials in which nothing is wrong")
parser.add_argument("--batches", type=int, metavar="N", help="batches with false trials in them")
parser.add_argument("--first", type=int, default=0, metavar="K", help="the first of them")
parser.add_argument("kinds", nargs="*", metavar="KIND", help=", ".join(KINDS))

if __name__ == "__main__":
    options = parser.parse_args()
    PLAYS = options.plays
    RATE_HZ = options.rate
    if options.alarms:
        alarms(options.first, options.first + options.alarms)
    elif options.batches:
        batches(options.first, options.first + options.batches)
    elif options.culprits:
        print(
            "| what happens | is | camera named | radio named | numbers named | robot named "
            "| other | off [mm] | driven, mean / most [mm] |"
        )
        print(f"|---|---|{'--:|' * 7}")
        culprits()
    elif options.slip:
        print(
            "| turn [rad/s] | stopped for it | off [mm] | ended for another reason "
            "| complete | off [mm] |"
        )
        print(f"|{'--:|' * 6}")
        slips()
    elif options.slow:
        print(
            "| pose shown | | refused | from the first command | off [mm] | at rest | off [mm] "
            "| later | off [mm] | at rest | off [mm] |"
        )
        print(f"|---|---{'|--:' * 9}|")
        for kind in options.kinds or SLOW:
            slow(kind)
    else:
        print("| pose shown | | noticed | off [mm] | stop [s] | rest [s] | driven [mm] | later |")
        print("|---|---|--:|--:|--:|--:|--:|--:|")
        for kind in options.kinds or KINDS[:-2]:
            ghosts(kind)
