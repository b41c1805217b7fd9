"""Tests that each name has one meaning: of classes, modules, packages, and in pages and specs."""

import ast
import re
import tomllib
from collections import defaultdict

import pytest
from testkit.paths import ROOT, SOURCE_FOLDERS

PACKAGES = (ROOT / "tetractl", *(ROOT / "packages").glob("*/tetractl_*"))
NAMED_AFTER = (
    "cli",
    "control/estimation/kernels",
    "control/search/kernels",
    "view/figures",
    "plant/disturbances",
)
"""Folders whose modules have the name of something else: a command's module that of what it runs, a
kernel's of what it compiles, a figure's and a disturbance's the one that a user writes."""
PARTS = {"actuator", "calibrate", "camera", "check", "core", "registries", "section", "side"}
"""Modules that each device has."""


def modules(package):
    return sorted(package.rglob("*.py"))


def from_root(path):
    return path.relative_to(ROOT).as_posix()


def public_classes(path):
    tree = ast.parse(path.read_text("utf-8"))
    names = [node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    return [name for name in names if not name.startswith("_")]


def repeated(places):
    """The names that occur in several places, with these."""
    return {name: paths for name, paths in places.items() if len(paths) > 1}


@pytest.mark.long
def test_a_class_has_a_name_of_its_own():
    places = defaultdict(list)
    for package in PACKAGES:
        for path in modules(package):
            for name in public_classes(path):
                places[name].append(from_root(path))
    assert repeated(places) == {}


def test_a_module_has_a_name_of_its_own():
    places = defaultdict(list)
    for package in PACKAGES:
        for path in modules(package):
            folder = path.parent.relative_to(package).as_posix()
            if folder not in NAMED_AFTER and path.stem not in {"__init__", *PARTS}:
                places[path.stem].append(from_root(path))
    assert repeated(places) == {}


def folders_by_layer():
    """The folders of tetractl in the order of the import contract, by its layers."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())
    contract = settings["tool"]["importlinter"]["contracts"][0]
    layers = []
    for layer in contract["layers"]:
        folders = [name for name in layer.split(" | ") if (ROOT / "tetractl" / name).is_dir()]
        if folders:
            layers.append(folders)
    return layers


def test_packages_are_listed_in_the_order_of_imports():
    layers = [", ".join(f"`{name}`" for name in layer) for layer in folders_by_layer()]
    words = (ROOT / "CONTRIBUTING.md").read_text().split()
    assert "; ".join(layers) in " ".join(words)


def test_the_map_for_contributors_fits_on_a_screen():
    """Its table of what is where has 25 rows at most."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    _, _, below = text.partition("| to change |")
    places, _, _ = below.partition("## What to run")
    assert len(re.findall(r"^\| (?!-)", places, re.M)) <= 25


def test_words_of_the_glossary_are_met_by_users():
    """Each word stands in the help of a command, in the reference of the spec, or in a message."""
    glossary, _, _ = (ROOT / "docs/reference/words.md").read_text().partition("## Terms")
    words = re.findall(r"^\| ([^|]+) \| [A-Z]", glossary, re.M)
    pages = [ROOT / "docs/reference" / f"{name}.md" for name in ("cli", "spec", "outcomes")]
    sources = [*pages, *ROOT.glob("tetractl/**/*.py"), *ROOT.glob("packages/*/tetractl_*/**/*.py")]
    met = " ".join(path.read_text("utf-8") for path in sources)
    assert len(words) >= 20
    assert [w for word in words for w in word.split(", ") if w not in met] == []
    meanings = re.findall(r"^\| .+ \| (.+) \|$", glossary, re.M)
    assert max(len(text.split()) for text in meanings) <= 30


def test_every_file_that_the_page_for_contributors_names_exists():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    named = re.findall(r"`([\w./-]+(?:\.\w+|/))`", text)
    existing = set()
    for folder in SOURCE_FOLDERS:
        existing.add(f"/{folder}")
        existing.update(f"/{from_root(path)}" for path in (ROOT / folder).rglob("*"))

    def exists(name):
        return any(path.endswith(f"/{name.strip('/')}") for path in existing)

    assert named
    assert [name for name in named if not exists(name)] == []
