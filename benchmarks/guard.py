"""Measures how soon the guard stops robots that a camera shows at false poses, all emulated.

    python benchmarks/guard.py                    every kind of false pose, two runs each
    python benchmarks/guard.py --rate 30          frames as rare as an AprilTag camera's
    python benchmarks/guard.py slow --plays 3     poses that drift away slowly
    python benchmarks/guard.py slip --plays 6     a pose that turns only while its robot drives
    python benchmarks/guard.py culprits           the causes that the reasons name
    python benchmarks/guard.py alarms --first 0 --plays 1000    the same trials without faults

The output is the figures of docs/reference/faults.md. Three m3pi robots drive with model predictive
control in the emulated lab, in virtual time. The camera has noise of 0.3 mm and 4 mrad, each wheel
is up to 10 % off, and 5 % of the packets are lost. The false poses come from the emulator's
`tests/testkit/emulator/ghosts.py`.

The table has the worst of all runs: the distance of the shown pose from its robot when this robot
was commanded to stop [mm], the time from the fault until then and until all robots stood still [s],
the distance that a robot drove in this time [mm], and the number of frames after which the false
pose was accepted after all.
"""

import argparse
import math
import re
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from testkit.emulator.ghosts import CAMERA_HZ, NUMBERS, Ghost, slow_radio, trial_of  # noqa: E402
from testkit.emulator.virtual_lab import VirtualLab  # noqa: E402

from tetractl.core.errors import AbortError  # noqa: E402

ALL_ROBOTS = (0, 1, 2)
FIRST_ROBOT = (0,)
ENDINGS = {
    "stopped": "another body|all robots drift|does not move|backward|the wrong way",
    "near something": "too close|about to leave|about to enter",
    "not noticed": "not noticed",
    "at rest": "still moves|seen to move as no command",
}
"""What the reason says first of a trial that was stopped while robots drove, ended because robots
truly came near to another, the edge or an obstacle, or was noticed only when they stood."""
CAUSES = {
    "camera": "all robots (drift together|are seen to move)",
    "radio": "is the radio slow",
    "numbers": "follow each other's commands",
    "robot": "(green|blue|red)(.s left wheel| moves| does not move| turns| still moves)",
}


def spread_starts(plays: int) -> list[float]:
    """Spread the times at which false poses begin evenly from 0.6 s to 2.1 s."""
    return [0.6 + 1.5 * k / max(1, plays - 1) for k in range(plays)]


def before_the_start(plays: int) -> list[float]:
    return [-math.inf] * plays


def with_the_first_command(plays: int) -> list[float]:
    return [0.0] * plays


def later(plays: int) -> list[float]:
    return [at_s for at_s in (0.6, 1.35, 2.1) for _ in range(-(-plays // 3))]


def in_turn(plays: int) -> list[float]:
    return [0.6 + 0.7 * k for k in range(plays)]


@dataclass(frozen=True)
class FalsePoseRow:
    """A row of the table: a kind of false pose, and the runs that show it.

    Attributes:
        label: Name of the row.
        kind: Kind of the false pose; see `testkit.emulator.ghosts`.
        size: Size of the false pose, in the unit of its kind.
        robots: Indices of the robots with a false pose. None for another robot in each run.
        starts: Returns when the false poses of the runs begin, from the first command [s].
        limit_s: Maximum duration of a run [s].
    """

    label: str
    kind: str
    size: float = 0.0
    robots: Sequence[int] | None = None
    starts: Callable[[int], list[float]] = in_turn
    limit_s: float = 60.0

    def line(self, plays: int, rate_hz: float) -> str:
        """Run the row's trials, and return its line of the table."""
        endings = Counter[str]()
        causes = Counter[str]()
        ghosts = []
        for k, at_s in enumerate(self.starts(plays)):
            ghost = Ghost(self.kind, self.size, self.robots or (k % 3,), at_s, self.limit_s)
            reason = self._run_trial(ghost, k, rate_hz)
            ghosts.append(ghost)
            endings[_first_match(ENDINGS, reason)] += 1
            causes[_first_match(CAUSES, reason)] += 1
        cells = (
            self.label,
            _format_counts(endings),
            _format_counts(causes),
            f"{max(ghost.off_mm for ghost in ghosts):.0f}",
            f"{max(ghost.held_s for ghost in ghosts):.2f}",
            f"{max(ghost.rest_s for ghost in ghosts):.2f}",
            f"{max(ghost.driven_mm for ghost in ghosts):.0f}",
            f"{sum(sum(ghost.late) for ghost in ghosts)}",
        )
        return f"| {' | '.join(cells)} |"

    def _run_trial(self, ghost: Ghost, trial: int, rate_hz: float) -> str:
        """Run a trial, and return why it was aborted or refused, or that it ended by itself."""
        is_radio = self.kind == "radio"
        disturb = partial(slow_radio, delay_s=self.size) if is_radio else ghost.haunt
        try:
            result = trial_of(disturb, trial, rate_hz)
        except AbortError:
            return "refused"
        return "complete" if result.outcome.complete else result.reason


def _first_match(patterns: dict[str, str], reason: str) -> str:
    """Return the first name whose pattern matches a reason.

    If no pattern matches, the result is "refused", "complete" or "other".
    """
    matching = [name for name, pattern in patterns.items() if re.search(pattern, reason)]
    return (matching or [reason if reason in ("refused", "complete") else "other"])[0]


def _format_counts(counter: Counter[str]) -> str:
    return ", ".join(f"{count} {name}" for name, count in counter.most_common())


def _slow_rows(
    label: str, kind: str, rate: float, robots: Sequence[int] | None = None
) -> list[FalsePoseRow]:
    return [
        FalsePoseRow(f"{label}, {starts.__name__.replace('_', ' ')}", kind, rate, robots, starts)
        for starts in (before_the_start, with_the_first_command, later)
    ]


PARTS = {
    "shown": [
        FalsePoseRow("frozen, one", "frozen", 0.0, FIRST_ROBOT, spread_starts, 5.0),
        FalsePoseRow("frozen, all", "frozen", 0.0, ALL_ROBOTS, spread_starts, 5.0),
        *(
            FalsePoseRow(f"{kind}, {speed} m/s", kind, speed, FIRST_ROBOT, spread_starts, 5.0)
            for kind in ("along", "against", "sideways", "heading", "curve")
            for speed in (0.05, 0.1, 0.2, 0.4)
        ),
    ],
    "slow": [
        *(
            row
            for rate in (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.6, 1.0, 1.25)
            for row in _slow_rows(f"turn, {rate} rad/s", "turn", rate)
        ),
        *_slow_rows("origin, 3 mm/s", "origin", 0.003, ALL_ROBOTS),
        *_slow_rows("origin, 10 mm/s", "origin", 0.01, ALL_ROBOTS),
        *_slow_rows("scale, 0.003 /s", "scale", 0.003, ALL_ROBOTS),
        *_slow_rows("scale, 0.01 /s", "scale", 0.01, ALL_ROBOTS),
    ],
    "slip": [
        FalsePoseRow(
            f"turn while driving, {rate} rad/s", "slip", rate, None, with_the_first_command
        )
        for rate in (0.1, 0.2)
    ],
    "culprits": [
        FalsePoseRow("the origin moves, 30 mm/s", "origin", 0.03, ALL_ROBOTS),
        FalsePoseRow("the origin moves, 100 mm/s", "origin", 0.1, ALL_ROBOTS),
        FalsePoseRow("the origin moves by 15 mm", "push", 0.015, ALL_ROBOTS),
        FalsePoseRow("the origin moves by 25 mm", "push", 0.025, ALL_ROBOTS),
        FalsePoseRow("the picture turns, 0.1 rad/s", "rotation", 0.1, ALL_ROBOTS),
        FalsePoseRow("the radio is 0.35 s late", "radio", 0.35, ALL_ROBOTS),
        FalsePoseRow("the radio is 0.5 s late", "radio", 0.5, ALL_ROBOTS),
        FalsePoseRow("one pose turns, 0.3 rad/s", "turn", 0.3),
        FalsePoseRow("one pose turns, 0.6 rad/s", "turn", 0.6),
        FalsePoseRow("one pose moves along, 30 mm/s", "along", 0.03),
        FalsePoseRow("one pose moves sideways, 30 mm/s", "sideways", 0.03),
        FalsePoseRow("one pose moves by 4 mm each 0.5 s", "steps"),
        FalsePoseRow("one robot is pushed by 12 mm", "push", 0.012),
        FalsePoseRow("one robot is pushed by 15 mm", "push", 0.015),
        FalsePoseRow("one robot is pushed by 25 mm", "push", 0.025),
        FalsePoseRow(
            "green and blue exchange numbers", NUMBERS, 0.0, (0, 1), with_the_first_command
        ),
        FalsePoseRow(
            "green and red exchange numbers", NUMBERS, 0.0, (0, 2), with_the_first_command
        ),
        FalsePoseRow("blue and red exchange numbers", NUMBERS, 0.0, (1, 2), with_the_first_command),
    ],
}


def print_alarms(first: int, trials: int, rate_hz: float) -> None:
    """Print each trial with a false alarm, and the maximum statistic of the drift check.

    A false alarm is a trial that did not end by itself, or in which a pose was refused.

    Args:
        first: Index of the first trial, which determines its random numbers.
        trials: Number of trials.
        rate_hz: Camera frames per second.
    """
    peak = 0.0
    labs: list[VirtualLab] = []
    endings = Counter[str]()

    def watch(lab: VirtualLab) -> None:
        labs.append(lab)
        lab.clock.steps.append(look)

    def look() -> None:
        nonlocal peak
        peak = max(peak, labs[-1].plant.rig.loop.guard.drift.worst_statistic)

    for trial in range(first, first + trials):
        result = trial_of(watch, trial, rate_hz)
        refusals = labs[-1].plant.rig.loop.guard.refusal_count
        ending = "complete" if result.outcome.complete else _first_match(ENDINGS, result.reason)
        endings[ending] += 1
        if refusals or not result.outcome.complete:
            print(f"trial {trial}: {result.summary}, {refusals} poses refused", flush=True)
    last = first + trials - 1
    print(f"trials {first} to {last}: {_format_counts(endings)}; greatest statistic {peak:.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("part", nargs="?", choices=[*PARTS, "alarms"], default="shown")
    parser.add_argument("--plays", type=int, default=2, metavar="N", help="of each row; trials")
    parser.add_argument("--first", type=int, default=0, metavar="K", help="first trial of alarms")
    parser.add_argument("--rate", type=float, default=CAMERA_HZ, help="camera frames a second")
    chosen = parser.parse_args()
    if chosen.part == "alarms":
        print_alarms(chosen.first, chosen.plays, chosen.rate)
        return
    print("| shown | ended | named | off [mm] | stop [s] | rest [s] | driven [mm] | later |")
    print(f"|---|---|---{'|--:' * 5}|")
    for row in PARTS[chosen.part]:
        print(row.line(chosen.plays, chosen.rate), flush=True)


if __name__ == "__main__":
    main()
