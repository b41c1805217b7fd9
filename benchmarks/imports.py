"""Counts the modules and lines of tetractl that one trial imports.

    python benchmarks/imports.py
    python benchmarks/imports.py experiments/five_robots.yaml --list

The script simulates trial 0 of a spec with `tetractl.run_trial` in a separate process. It counts
the modules of tetractl that are loaded at the end, and the lines of their files. Without a spec, it
counts three times: for the paper's experiment, for the same experiment with a log, and for the
paper's lab, emulated with `tetractl run`. `--list` names the modules, longest first.
"""

import json
import subprocess
import sys
from argparse import ArgumentParser
from collections import Counter
from pathlib import Path
from tempfile import TemporaryDirectory

EXPERIMENTS = Path(__file__).parents[1] / "experiments"
SCRIPT = "import sys, tetractl; tetractl.run_trial(sys.argv[1])\n"
"""Simulates a trial, as a script does."""
LOGGED = "import sys, tetractl; tetractl.run_trial(sys.argv[1], folder='logs')\n"
"""Simulates a trial, writes its log, and reads it."""
COMMAND = """
import sys
from tetractl.cli.app import run_app

words = "--plant emulated --trials 1 --yes --quiet --out logs"
sys.argv = ["tetractl", "run", sys.argv[1], *words.split()]
assert run_app() == 0
"""
"""Runs a trial of a lab in its emulator, as a command does."""
COUNT = """
import sys
import json
from pathlib import Path

files = {name: getattr(module, "__file__", None) for name, module in sys.modules.items()}
ours = {name: file for name, file in files.items() if file and name.startswith("tetractl")}
lines = {name: len(Path(file).read_text("utf-8").splitlines()) for name, file in ours.items()}
Path("lines.json").write_text(json.dumps(lines))
"""


def imported(program: str, spec: Path) -> dict[str, int]:
    """Run a program on a spec, and return the number of lines of each module that it imports."""
    with TemporaryDirectory() as folder:
        command = [sys.executable, "-c", program + COUNT, str(spec.resolve())]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
        return json.loads(Path(folder, "lines.json").read_text("utf-8"))


def report(title: str, lines: dict[str, int], named: bool) -> None:
    """Print the number of modules and lines of each package. If `named`, also list the modules."""
    print(title)
    modules = Counter[str]()
    total = Counter[str]()
    for name, number in lines.items():
        package = name.partition(".")[0]
        modules[package] += 1
        total[package] += number
    for package in sorted(modules):
        print(f"  {package}: {modules[package]} modules, {total[package]:,} lines")
    if named:
        for name, number in sorted(lines.items(), key=lambda row: -row[1]):
            print(f"  {number:>6} {name}")


def main() -> None:
    """Count the imports of a spec's trial, or of the paper's trial and the paper's lab."""
    parser = ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("spec", nargs="?", type=Path)
    parser.add_argument("--list", action="store_true", help="name the modules, longest first")
    given = parser.parse_args()
    if given.spec:
        report(given.spec.stem, imported(SCRIPT, given.spec), given.list)
        return
    paper = EXPERIMENTS / "three_m3pi_paper.yaml"
    report("the paper's experiment, simulated", imported(SCRIPT, paper), given.list)
    report("the same, with a log", imported(LOGGED, paper), given.list)
    lab = EXPERIMENTS / "three_m3pi_paper_lab.yaml"
    report("the paper's lab, emulated", imported(COMMAND, lab), given.list)


if __name__ == "__main__":
    main()
