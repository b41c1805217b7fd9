"""The tools that keep the documentation true: those in docs/."""

import importlib.util
import sys
from types import ModuleType

from support.paths import ROOT


def _tool(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"docs_{name}", ROOT / "docs" / f"{name}.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


console = _tool("console")
make_cli = _tool("make_cli")
make_layouts = _tool("make_layouts")
