"""Tests of what each package of this repository needs, and of the core without them."""

import re
import subprocess
import sys
import tomllib

import pytest
from testkit.paths import EXAMPLES as MICROSCOPE_EXAMPLES
from testkit.paths import ROOT

from tetractl.core import __version__
from tetractl.core.registries import EXAMPLES
from tetractl.spec.packages import PROVIDERS

PROJECTS = sorted((ROOT / "packages").glob("*/pyproject.toml"))
OURS = {path.parent.name for path in PROJECTS}
HIDDEN = (
    f"""
OURS = {OURS!r}
"""
    + """
import sys
import importlib.metadata

PACKAGES = {name.replace("-", "_") for name in OURS}

class Hidden:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {"cv2", "imageio", *PACKAGES}:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Hidden())
found = importlib.metadata.entry_points

def points(**by):
    got = found(**by)
    if not by.get("group", "").startswith("tetractl."):
        return got
    return [one for one in got if one.dist.name not in OURS]

importlib.metadata.entry_points = points
"""
)


def python(program):
    done = subprocess.run(
        [sys.executable, "-c", HIDDEN + program], capture_output=True, text=True, cwd=ROOT
    )
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("project", PROJECTS, ids=lambda path: path.parent.name)
def test_versions_move_together(project):
    text = project.read_text()
    assert tomllib.loads(text)["project"]["version"] == __version__
    assert text.count(f"=={__version__}") == text.count("==")


@pytest.mark.parametrize("project", PROJECTS, ids=lambda path: path.parent.name)
def test_what_a_package_brings_is_named_where_it_is_missing(project):
    metadata = tomllib.loads(project.read_text())["project"]
    for group in {group for group, _ in PROVIDERS}:
        brought = {
            name
            for (brought_group, name), package in PROVIDERS.items()
            if (brought_group, package) == (group, metadata["name"])
        }
        points = metadata["entry-points"].get(group, {})
        if group == EXAMPLES.group and points:
            brings = {name.partition("/")[0] for name in _names(project.parent)}
            assert brought == brings and list(points.values()) == [f"{module(project)}:EXAMPLES"]
        else:
            assert brought <= set(points), group


def module(project):
    return f"{project.parent.name.replace('-', '_')}.registries"


def _names(package):
    (folder,) = package.glob("tetractl_*/examples")
    paths = [path.relative_to(folder) for path in folder.rglob("*.yaml")]
    return [path.with_suffix("").as_posix() for path in paths]


COMMAND = "from tetractl.cli.app import run_app\nsys.argv[1:] = {!r}\nsys.exit(run_app())"


def test_tests_of_the_core_need_no_package():
    """So that `pytest tests/unit` runs where the core alone is installed."""
    files = [*ROOT.glob("tests/**/*.py")]
    for_packages = ("tests/testkit/emulator/", "tests/testkit/microscope/")
    files = [path for path in files if not str(path.relative_to(ROOT)).startswith(for_packages)]
    needs = r"tetractl_|cv2|tifffile|testkit\.(emulator|microscope)"
    imports = re.compile(rf"^ *(from|import) ({needs})", re.M)
    assert files
    assert [path for path in files if imports.search(path.read_text("utf-8"))] == []


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize(
    ("package", "words"),
    [
        ("tetractl-emulator", ["lab", "emulate", "x.yaml"]),
        ("tetractl-emulator", ["run", "experiments/three_m3pi_lab.yaml", "--plant", "emulated"]),
        ("tetractl-microscope", ["track", "dish.avi"]),
        ("tetractl-papers", ["reproduce", "ou"]),
        ("tetractl-identify", ["identify", "x.mcap"]),
        ("tetractl-papers", ["run", "SPEC", "--set", "controller={type: rrt}"]),
        ("tetractl-papers", ["plot", "x.mcap", "--kind", "swarm"]),
        ("tetractl-learn", ["validate", "SPEC", "--set", "controller={type: policy}"]),
        ("tetractl-testing", ["kinds", "--check", "tetractl.model.motion.exact:EXACT"]),
        ("tetractl-microscope", ["validate", str(MICROSCOPE_EXAMPLES / "tetrahymena_dish.yaml")]),
        ("tetractl-microscope", ["init", "--example", "two_cells"]),
        ("tetractl-microscope", ["init", "x", "--lab", "--camera", "apriltag"]),
        ("tetractl-emulator", ["init", "--example", "faults/apriltag/drips"]),
        ("tetractl-toio", ["init", "x", "--lab", "--robots", "toio"]),
        ("tetractl-ros2", ["init", "x", "--lab", "--camera", "ros2", "--robots", "ros2"]),
        ("tetractl-motioncapture", ["init", "x", "--lab", "--camera", "motioncapture"]),
    ],
)
def test_what_a_missing_package_brings_is_answered_by_the_command_that_installs_it(package, words):
    words = [word.replace("SPEC", "experiments/three_m3pi.yaml") for word in words]
    code, said = python(COMMAND.format(words))
    assert code == 2, said
    assert f"needs {package}, which is not installed" in said
    assert f"pip install ./packages/{package}" in said


def test_the_core_requires_at_most_twelve_libraries_each_with_its_reason():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    names = [re.split(r"[>=<\[]", requirement)[0] for requirement in project["dependencies"]]
    reasons = (ROOT / "docs" / "decisions" / "program.md").read_text()
    _, _, section = reasons.partition("## Libraries")
    table, _, _ = section.partition("Further libraries")
    rows = [line for line in table.splitlines() if line.startswith("| `")]
    listed = [name for row in rows for name in re.findall(r"`([\w-]+)`", row.split("|")[1])]
    assert sorted(listed) == sorted(names)
    assert len(names) <= 12
