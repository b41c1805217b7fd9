"""Measures the controller where its model has a wrong shape, and prints what the operator reads.

    python benchmarks/wrong_shapes.py --seed 512306301
    python benchmarks/wrong_shapes.py --world rolling pivot --trials 2 --seed 1 --each

The worlds are `WRONG_SHAPES` of `benchmarks/worlds`. For no value of any parameter do these robots
move as the model does. The table is printed in docs/reference/measured.md. Below it are the
messages, with the number of trials in which each was given; # stands for a number, and NAME for a
robot. --each also prints each trial with its messages.
"""

import argparse
import re
from collections import Counter
from collections.abc import Sequence

from solverbench.report import describe_load, print_progress
from worlds import WORLDS, WRONG_SHAPES
from worlds.trials import HEAD, Row, Task, line, run

from tetractl.core.protocols import Observer
from tetractl.core.trial import Note, Result, Start


class Messages(Observer):
    """Keeps the messages of one trial, and how it ended."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self.names: tuple[str, ...] = ()
        self.end = ""

    def on_start(self, start: Start) -> None:
        self.names = tuple(start.setup.names)

    def on_note(self, note: Note) -> None:
        if note.level in ("info", "warning"):
            self.texts.append(note.text)

    def on_stop(self, stop: object, result: Result) -> None:
        self.end = result.outcome.value
        if result.reason:
            self.texts.append(result.reason)

    def patterns(self) -> set[str]:
        """Return the messages with # for each number and NAME for each robot."""
        names = "|".join(map(re.escape, self.names))
        return {
            re.sub(r"-?\d+(\.\d+)?", "#", re.sub(rf"\b({names})\b", "NAME", text))
            for text in self.texts
        }


def show(trial: int, row: Row, messages: Messages) -> None:
    """Print one trial with its messages."""
    rooms = f"obstacle {row.obstacle:.0f}, edge {row.edge:.0f}, apart {row.apart:.0f}"
    print(f"  {trial}: {row.error:.1f} after {row.seconds:.1f} s, {messages.end}; {rooms}")
    for text in messages.texts:
        print(f"     {text}")


def report(world: str, trials: Sequence[tuple[Row, Messages]]) -> str:
    """Format how often the trials of a world ended in each way, and with which messages."""
    ends = Counter(messages.end for _, messages in trials)
    texts = Counter(text for _, messages in trials for text in messages.patterns())
    lines = [f"`{world}`: " + ", ".join(f"{n} {end}" for end, n in ends.most_common())]
    lines += [f"  {n} of {len(trials)}: {text}" for text, n in texts.most_common()]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--world", nargs="+", choices=WORLDS, default=WRONG_SHAPES, metavar="WORLD")
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--set", action="append", default=[], help="a setting of every spec")
    parser.add_argument("--each", action="store_true", help="also print each trial")
    options = parser.parse_args()
    print(f"Simulated, seed {options.seed}. {describe_load()}.\n\n{HEAD}")
    reports: list[str] = []
    for world in options.world:
        print_progress(world)
        place = " --set ".join([world, *options.set])
        trials: list[tuple[Row, Messages]] = []
        for trial in range(options.trials):
            messages = Messages()
            row = run(Task(options.seed, place, trial), [messages])
            trials.append((row, messages))
            if options.each:
                show(trial, row, messages)
        print(line(f"`{world}`", [row for row, _ in trials]), flush=True)
        reports.append(report(world, trials))
    print("\n" + "\n".join(reports))


if __name__ == "__main__":
    main()
