"""Writes packages with entry points to a folder, as pip would leave them."""

import os
import subprocess
import sys
from pathlib import Path


def install(folder: Path, name: str, version: str, points: str, **modules: str) -> Path:
    """Put a package into a folder: its metadata, `points` as entry_points.txt, and its modules."""
    info = folder / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    about = f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n"
    (info / "METADATA").write_text(about, encoding="utf-8")
    (info / "entry_points.txt").write_text(points, encoding="utf-8")
    for module, code in modules.items():
        (folder / f"{module}.py").write_text(code, encoding="utf-8")
    return folder


def python(folder: Path, sites: list[Path], *words: object, **env: str):
    """Run Python in a folder, with the packages of other folders installed; what it did."""
    folders = [str(site) for site in sites]
    if os.environ.get("PYTHONPATH"):
        folders.append(os.environ["PYTHONPATH"])
    path = os.pathsep.join(folders)
    return subprocess.run(
        [sys.executable, *map(str, words)], cwd=folder, capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": path} | env,
    )  # fmt: skip
