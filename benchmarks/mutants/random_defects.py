"""Plants random defects in the product, one at a time, and reports which of them the tests find.

    python benchmarks/mutants/random_defects.py --seed 7 --count 20
    python benchmarks/mutants/random_defects.py --seed 7 --count 10 tetractl/log
    python benchmarks/mutants/random_defects.py --seed 7 --count 20 --whole

A defect changes one operator: a comparison, `and` or `or`, `+` or `-`, `*` or `/`, `min` or `max`,
a `not`, or the condition of an `if`. It is planted in a copy of the sources. Then three groups of
tests run there until one fails: the test files named like the changed file, those of its folder,
and those elsewhere that import its module. With `--whole`, all of `make test` runs on survivors.

Use a seed that nobody has used before: a list of defects that somebody has seen measures how well
the tests were tuned to it. A survivor that changes nothing which a user can observe (a tie, a limit
that is never reached, a cache) is *equivalent*. Discount it only with a reason.
"""

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PRODUCT = ("tetractl", "packages")
MARKS = "not long and not system"
LEFT_OUT = shutil.ignore_patterns(".git", ".venv*", "logs", "build", "dist", "__pycache__")
NAMING_FILES_MAX = 8
"""Maximum number of test files outside the folder that are run because they name the module."""
COMPARISONS = {
    ast.Lt: ("<", ">="),
    ast.Gt: (">", "<="),
    ast.LtE: ("<=", ">"),
    ast.GtE: (">=", "<"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.Is: ("is", "is not"),
    ast.IsNot: ("is not", "is"),
    ast.In: ("in", "not in"),
    ast.NotIn: ("not in", "in"),
}
ARITHMETIC = {ast.Add: ("+", "-"), ast.Sub: ("-", "+"), ast.Mult: ("*", "/"), ast.Div: ("/", "*")}
CALLS = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum"}


@dataclass(frozen=True)
class Site:
    """A place where one operator can be changed.

    Attributes:
        path: The source file.
        line: The line of the operator, from 1.
        start: Offset of the first changed byte.
        end: Offset behind the last changed byte.
        old: The text between the offsets.
        new: The text that takes its place.
    """

    path: Path
    line: int
    start: int
    end: int
    old: str
    new: str

    def changed(self) -> bytes:
        """Return the contents of the file with the defect."""
        data = self.path.read_bytes()
        return data[: self.start] + self.new.encode() + data[self.end :]


def find_sites(path: Path) -> list[Site]:
    """List every operator of a source file that can be changed."""
    source = path.read_bytes()
    finder = _SiteFinder(path, source)
    finder.visit(ast.parse(source))
    return [site for site in finder.sites if source[site.start : site.end].decode() == site.old]


class _SiteFinder(ast.NodeVisitor):
    """Visits the syntax tree of a file and collects the sites."""

    def __init__(self, path: Path, source: bytes) -> None:
        self.sites: list[Site] = []
        self._path = path
        self._source = source
        self._line_starts = [0]
        for line in source.splitlines(keepends=True):
            self._line_starts.append(self._line_starts[-1] + len(line))

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        if node.name not in ("__repr__", "__str__"):
            self.generic_visit(node)

    def visit_If(self, node: ast.If) -> None:
        if ast.unparse(node.test) == "TYPE_CHECKING":
            return
        self._negate(node.test)
        self.generic_visit(node)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        self._negate(node.test)
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        if len(node.ops) == 1:
            self._replace_between(node.left, node.comparators[0], COMPARISONS[type(node.ops[0])])
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        names = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
        self._replace_between(node.values[0], node.values[1], names)
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        operators = ARITHMETIC.get(type(node.op))
        if operators and not (_is_sequence(node.left) or _is_sequence(node.right)):
            self._replace_between(node.left, node.right, operators)
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, ast.Not):
            start = self._offset(node.lineno, node.col_offset)
            self.sites.append(Site(self._path, node.lineno, start, start + 4, "not ", ""))
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        function = node.func
        name = getattr(function, "id", getattr(function, "attr", ""))
        if name in CALLS:
            end = self._offset(function.end_lineno or 0, function.end_col_offset or 0)
            line = function.end_lineno or 0
            self.sites.append(Site(self._path, line, end - len(name), end, name, CALLS[name]))
        self.generic_visit(node)

    def _offset(self, line: int, column: int) -> int:
        return self._line_starts[line - 1] + column

    def _negate(self, condition: ast.expr) -> None:
        """Add a site in front of a condition that has no operator of its own."""
        if isinstance(condition, ast.Name | ast.Attribute | ast.Call):
            start = self._offset(condition.lineno, condition.col_offset)
            self.sites.append(Site(self._path, condition.lineno, start, start, "", "not "))

    def _replace_between(self, left: ast.expr, right: ast.expr, operators: tuple[str, str]) -> None:
        """Add a site for the operator that stands between two expressions."""
        old, new = operators
        line = left.end_lineno or 0
        gap_start = self._offset(line, left.end_col_offset or 0)
        gap = self._source[gap_start : self._offset(right.lineno, right.col_offset)].decode()
        if gap.count(old) == 1 and "#" not in gap:
            start = gap_start + len(gap[: gap.index(old)].encode())
            self.sites.append(Site(self._path, line, start, start + len(old), old, new))


def _is_sequence(node: ast.expr) -> bool:
    """Check whether an operand is a string, a list or a tuple, which cannot be subtracted."""
    is_string = isinstance(node, ast.Constant) and isinstance(node.value, str)
    return is_string or isinstance(node, ast.JoinedStr | ast.List | ast.Tuple)


def product_files(folders: Sequence[str]) -> list[Path]:
    """List the Python files of the product, without tests and generated code."""
    listing = subprocess.run(
        ["git", "ls-files", "--", *folders], cwd=ROOT, capture_output=True, text=True, check=True
    )
    names = [Path(name) for name in listing.stdout.split() if name.endswith(".py")]
    return [
        ROOT / name
        for name in names
        if "tests" not in name.parts and not name.name.endswith("_pb2.py")
    ]


def groups_of_tests(path: Path) -> Iterator[list[str]]:
    """Yield groups of test files for a source file, the closest group first.

    The folder of a module is the nearest one above it that has tests. If a module of a package has
    no such folder and no test file named like it, the last group has all tests of the package. A
    file is in one group only, and no group is empty.
    """
    name = path.relative_to(ROOT)
    in_package = name.parts[0] == "packages"
    imported = Path(*name.with_suffix("").parts[2 if in_package else 0 :])
    tests = ROOT / "packages" / name.parts[1] / "tests" if in_package else ROOT / "tests"
    files = sorted(tests.rglob("test_*.py"))
    everywhere = [ROOT / "tests", *sorted(ROOT.glob("packages/*/tests")), ROOT / "benchmarks"]
    all_files = [file for folder in everywhere for file in sorted(folder.rglob("test_*.py"))]
    module = ".".join(imported.parts)
    package = re.escape(".".join(imported.parts[:-1]))
    names_module = re.compile(rf"{re.escape(module)}\b|from {package} import .*\b{imported.stem}\b")
    naming = [file for file in all_files if names_module.search(file.read_text(encoding="utf-8"))]
    groups = [
        [file for file in files if imported.stem.strip("_") in file.stem],
        _tests_of_folder(imported.parts[1:-1], files),
        naming[:NAMING_FILES_MAX],
    ]
    if in_package and not any(groups[:2]):
        groups.append(files)
    done = set[Path]()
    for group in groups:
        new = [file for file in group if file not in done]
        done.update(new)
        if new:
            yield [str(file.relative_to(ROOT)) for file in new]


def _tests_of_folder(folders: Sequence[str], files: Sequence[Path]) -> list[Path]:
    """List the test files in the innermost of nested folders that has any."""
    for folder in reversed(folders):
        found = [file for file in files if folder in file.parent.parts]
        if found:
            return found
    return []


def compiled_folder(tree: Path) -> Path:
    """Return the folder of compiled kernels for the tests of a copy.

    It is not the user's: a defect in how kernels are named would leave wrong code there, which
    later ends other processes.
    """
    return tree.with_name("compiled")


def first_failure(tree: Path, tests: Sequence[str], limit_s: float) -> str:
    """Run tests in a copy of the sources.

    Args:
        tree: The copy.
        tests: Names of test files or folders, relative to it.
        limit_s: Time after which the run is ended [s].

    Returns:
        The first test that fails, "time limit" if the tests do not end, or "" if all pass.
    """
    packages = [str(folder) for folder in (tree / "packages").iterdir()]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(tree), *packages]),
        "NUMBA_CACHE_DIR": str(compiled_folder(tree)),
    }
    words = [sys.executable, "-m", "pytest", "-x", "--tb=no", "-m", MARKS, *tests]
    try:
        done = subprocess.run(
            words, cwd=tree, env=environment, capture_output=True, text=True, timeout=limit_s
        )
    except subprocess.TimeoutExpired:
        return "time limit"
    if done.returncode in (0, 5):  # all passed, or none was selected
        return ""
    failures = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return failures[0].split(" - ")[0] if failures else f"exit status {done.returncode}"


def find_defect(tree: Path, site: Site, limit_s: float, whole: bool) -> str:
    """Plant a defect in a copy of the sources, run the tests, and take it out again.

    Args:
        tree: The copy.
        site: The defect.
        limit_s: Time limit for each group of tests [s].
        whole: Whether to run all of `make test` if no group finds the defect.

    Returns:
        The first test that fails, or "" if the defect survives.
    """
    planted = tree / site.path.relative_to(ROOT)
    planted.write_bytes(site.changed())
    groups = [*groups_of_tests(site.path), *([["."]] if whole else [])]
    try:
        for group in groups:
            failure = first_failure(tree, group, limit_s)
            if failure:
                return failure
        return ""
    finally:
        planted.write_bytes(site.path.read_bytes())
        if "tools" in site.path.parts:  # such as how kernels are named
            shutil.rmtree(compiled_folder(tree), ignore_errors=True)


def choose_sites(folders: Sequence[str], seed: int, count: int) -> list[Site]:
    """Choose sites at random, each operator of the product with the same probability."""
    sites = [site for path in product_files(folders) for site in find_sites(path)]
    return random.Random(seed).sample(sites, min(count, len(sites)))


def main() -> None:
    """Parse the command line, plant the defects, and print a row for each."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folders", nargs="*", default=PRODUCT, help="where to plant defects")
    parser.add_argument("--seed", type=int, required=True, help="one that was never used before")
    parser.add_argument("--count", type=int, default=20, help="number of defects")
    parser.add_argument("--limit", type=float, default=600.0, help="time of a group of tests [s]")
    parser.add_argument("--whole", action="store_true", help="run `make test` on survivors")
    options = parser.parse_args()
    sites = choose_sites(options.folders, options.seed, options.count)
    found = 0
    with tempfile.TemporaryDirectory() as scratch:
        tree = Path(scratch) / "tetractl"
        shutil.copytree(ROOT, tree, ignore=LEFT_OUT)
        for number, site in enumerate(sites, 1):
            failure = find_defect(tree, site, options.limit, options.whole)
            found += bool(failure)
            code = site.path.read_text(encoding="utf-8").splitlines()[site.line - 1].strip()
            place = f"{site.path.relative_to(ROOT)}:{site.line}"
            change = f"`{site.old}` -> `{site.new}` in `{code}`"
            print(f"{number:3} {failure or 'SURVIVES'} | {place} | {change}", flush=True)
    print(f"found {found} of {len(sites)} (seed {options.seed})")


if __name__ == "__main__":
    main()
