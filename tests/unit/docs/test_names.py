"""One name, one meaning: of classes and modules in the package."""

import ast
from collections import defaultdict

from support.paths import ROOT

PACKAGE = ROOT / "tetractl"
NAMED_AFTER = (  # a command's module after what it runs, a kernel's after what it compiles, a
    # figure's and a disturbance's after the name that a user writes
    "cli",
    "control/kernels",
    "view/figures",
    "plant/disturbances",
)
PARTS = {"actuator", "calibrate", "camera", "check", "core", "section", "side"}  # of each device


def test_a_class_has_a_name_of_its_own():
    places = defaultdict(list)
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(path.relative_to(ROOT).as_posix())
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def test_a_module_has_a_name_of_its_own():
    places = defaultdict(list)
    for path in PACKAGE.rglob("*.py"):
        room = path.parent.relative_to(PACKAGE).as_posix()
        if room not in NAMED_AFTER and path.stem not in {"__init__", *PARTS}:
            places[path.stem].append(path.relative_to(ROOT).as_posix())
    assert {name: found for name, found in places.items() if len(found) > 1} == {}
