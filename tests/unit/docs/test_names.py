"""One name, one meaning: of classes, modules, packages, and of what pages and specs name."""

import ast
import re
import tomllib
from collections import defaultdict

from support.paths import ROOT

from tetractl.experiment.load import load_spec

EXPERIMENTS = ROOT / "experiments"
HOUSES = (ROOT / "tetractl", *(ROOT / "packages").glob("*/tetractl_*"))
NAMED_AFTER = (  # a command's module after what it runs, a kernel's after what it compiles, a
    # figure's and a disturbance's after the name that a user writes
    "cli",
    "control/kernels",
    "view/figures",
    "plant/disturbances",
)
PARTS = {
    "actuator",
    "calibrate",
    "camera",
    "check",
    "core",
    "registries",
    "section",
    "side",
}  # of each device


def test_a_class_has_a_name_of_its_own():
    places = defaultdict(list)
    for path in (path for house in HOUSES for path in house.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(path.relative_to(ROOT).as_posix())
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def test_a_module_has_a_name_of_its_own():
    places = defaultdict(list)
    for root, path in ((house, path) for house in HOUSES for path in house.rglob("*.py")):
        room = path.parent.relative_to(root).as_posix()
        if room not in NAMED_AFTER and path.stem not in {"__init__", *PARTS}:
            places[path.stem].append(path.relative_to(ROOT).as_posix())
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def test_a_film_is_a_recording_that_track_follows_and_a_video_shows_a_trial():
    pages = [ROOT / "docs/how-to" / page for page in ("replay-and-plot.md", "share.md")]
    said = {
        path.relative_to(ROOT).as_posix()
        for path in (*(ROOT / "tetractl").rglob("*.py"), *pages)
        if "film" in path.name + path.read_text("utf-8").lower()
    }
    assert said <= {f"tetractl/log/{name}.py" for name in ("format/channels", "read/raw_log")}


def test_both_controllers_run_on_one_bench():
    ours, published = (
        load_spec(EXPERIMENTS / f"{name}.yaml").experiment
        for name in ("three_m3pi_bench", "three_m3pi_paper_bench")
    )
    assert ours.plant == published.plant
    assert ours.robots == published.robots
    paper = load_spec(EXPERIMENTS / "three_m3pi_paper.yaml").experiment
    assert published.controller == paper.controller


def test_packages_are_listed_in_the_order_of_imports():
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = [layer.split(" | ") for layer in contract["contracts"][0]["layers"]]
    packages = [[p for p in layer if (ROOT / "tetractl" / p).is_dir()] for layer in layers]
    text = " ".join((ROOT / "CONTRIBUTING.md").read_text().split())
    assert "; ".join(", ".join(f"`{p}`" for p in layer) for layer in packages if layer) in text


def test_the_page_for_contributors_is_read_in_ten_minutes():
    """At 180 words a minute; each word of the house is defined in at most thirty."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    assert len(text.split()) <= 1800
    rows = re.findall(r"^\| .+ \| (.+) \|$", text.partition("## Words of this house")[2], re.M)
    assert len(rows) > 20
    assert max(len(row.split()) for row in rows) <= 30


def test_every_file_that_the_page_for_contributors_names_exists():
    said = re.findall(r"`([\w./-]+(?:\.\w+|/))`", (ROOT / "CONTRIBUTING.md").read_text())
    roots = (
        "tetractl",
        "packages",
        "tools",
        "docs",
        "tests",
        "benchmarks",
        "experiments",
        "examples",
    )
    there = {f"/{one.relative_to(ROOT)}" for root in roots for one in (ROOT / root).rglob("*")}
    there |= {f"/{root}" for root in roots}
    lost = {name for name in said if not any(p.endswith(f"/{name.strip('/')}") for p in there)}
    assert lost == set()
