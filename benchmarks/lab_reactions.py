"""How fast a lab run reacts to each fault: from what the emulated lab saw, no hardware.

    python benchmarks/lab_reactions.py [--repeat N] [NAME ...]

Plays the emulator's scripts of faults end to end and prints a Markdown table: from the fault's
first visible moment to the stop on the radio's port, and to the robots at rest; worst of N plays.
The limit is the fault's own tolerance plus 100 ms.
"""

import argparse
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / one) for one in ("tests", "packages/tetractl-emulator/tests")]

from support.lab_processes import play  # noqa: E402
from support.scripts import load_script  # noqa: E402


def measure(path: Path) -> tuple[float | None, float, float]:
    """Play a script once; return ms to the stop, None where none can be sent, to rest, and the
    emulator's worst lag."""
    script = load_script(path)
    with tempfile.TemporaryDirectory() as folder:
        played = play(path, script, Path(folder))
    expect = script.expect
    assert expect is not None
    seen = played.seen_ns()
    names = expect.robots or played.record[0]["robots"]
    stop = None
    if expect.tolerance is not None:
        stop = max(played.stop_after(name, seen) for name in names) * 1e3
    rest = max(played.rest_after(name, seen) for name in names) * 1e3
    return stop, rest, played.record[-1]["worst_lag_ms"]


def main() -> None:
    """Print the table, a row as soon as it is known."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=3, metavar="N")
    parser.add_argument("names", nargs="*", metavar="NAME")
    options = parser.parse_args()
    print("| fault | plays | stop [ms] | limit [ms] | at rest [ms] | emulator's worst lag [ms] |")
    print("|---|--:|--:|--:|--:|--:|")
    for path in sorted((ROOT / "packages/tetractl-emulator/faults").glob("*.yaml")):
        expect = load_script(path).expect
        assert expect is not None
        timed = expect.tolerance is not None or expect.still is not None
        if (
            not timed
            or expect.outcome == "done"
            or (options.names and path.stem not in options.names)
        ):
            continue
        plays = [measure(path) for _ in range(options.repeat)]
        stops = [stop for stop, _, _ in plays if stop is not None]
        limit = "" if expect.tolerance is None else f"{1e3 * expect.tolerance + 100:.0f}"
        stop = f"{max(stops):.0f}" if stops else ""
        rest, lag = max(rest for _, rest, _ in plays), max(lag for _, _, lag in plays)
        print(
            f"| {path.stem} | {len(plays)} | {stop} | {limit} | {rest:.0f} | {lag:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
