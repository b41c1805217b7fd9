"""Measures the closed loop in plants with effects that the controller's model lacks.

    python benchmarks/unmodelled.py --world sides later-5hz --trials 30 --jobs 2 --out new.csv
    python benchmarks/unmodelled.py --trials 0 --out new.csv --against old.csv

The output is "Where the model lacks something" of docs/reference/measured.md, for each world of
`benchmarks/worlds`. --out keeps a CSV file, to which trials are added. --against prints the
differences from the same trials of another version.
"""

import argparse
from pathlib import Path

from solverbench.report import describe_load
from worlds import WORLDS
from worlds.trials import HEAD, PAIRS_HEAD, Row, Task, extended, line, pair_lines, read


def main() -> None:
    names = [f"{name}{rate}" for name in WORLDS for rate in ("", "-5hz")]
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--world", nargs="+", choices=names, metavar="WORLD", default=[*WORLDS])
    parser.add_argument("--trials", type=int, default=30)
    parser.add_argument("--seed", type=int, default=20261124)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--set", action="append", default=[], help="a setting of every spec")
    parser.add_argument("--out", type=Path, help="CSV of the trials")
    parser.add_argument("--against", type=Path, help="that of another version")
    options = parser.parse_args()
    print(f"Simulated, seed {options.seed}. {describe_load()}.\n\n{HEAD}")
    places = [" --set ".join([name, *options.set]) for name in options.world]
    tasks = [
        Task(options.seed, place, trial) for place in places for trial in range(options.trials)
    ]
    rows_of: dict[str, list[Row]] = {}
    for task, row in extended(options.out, tasks, options.jobs).items():
        if task.seed == options.seed:
            rows_of.setdefault(task.place, []).append(row)
    for place, rows in rows_of.items():
        print(line(f"`{place}`", rows))
    if options.against:
        lines = pair_lines("version", read(options.against), read(options.out))
        print("\n".join(["", PAIRS_HEAD, *lines]))


if __name__ == "__main__":
    main()
