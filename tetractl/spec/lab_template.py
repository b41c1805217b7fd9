"""Compose the spec that `tetractl init --lab` writes, from a part for robots and one for cameras.

A part is a file `robots/KIND.yaml` or `cameras/KIND.yaml`, in this package or in a folder of the
registry TEMPLATES. The robots' part is a spec. Its line `@CAMERA@` is replaced by the camera's
part. Robots that measure their own poses have no such line. In a camera's part, a line with
`@ROBOT@` is repeated for each robot. `@I@` is the robot's index, `@WIDTH@` and `@HEIGHT@` are the
size of the arena.
"""

from collections.abc import Sequence
from pathlib import Path

from tetractl.core.errors import UsageError
from tetractl.core.registries import ACTUATORS, CAMERAS, TEMPLATES
from tetractl.spec.packages import not_installed
from tetractl.spec.yaml.document import parse_document
from tetractl.spec.yaml.problems import did_you_mean

OURS = Path(__file__).parent / "templates"
PLACE = "@CAMERA@\n"


def lab_template(robots: str, camera: str | None) -> str:
    """Return the spec for a kind of robots and a kind of camera.

    Args:
        robots: The kind of robots.
        camera: The kind of camera. None for the robots' own camera, or else `optitrack`.

    Raises:
        UsageError: If there is no such part, or if the robots have a camera of their own.
    """
    text = _part("robots", robots)
    if PLACE not in text:
        if camera not in (None, robots):
            raise UsageError(
                f"robots of type {robots} measure their own poses, so --camera cannot be given",
                "leave --camera out",
            )
        return text
    spec = parse_document(text.replace(PLACE, "").replace("@NAME@", "name: robots"), robots).data
    names = [robot["name"] for robot in spec["robots"]]
    part = _for_each_robot(_part("cameras", camera or "optitrack"), names)
    for side in ("width", "height"):
        part = part.replace(f"@{side.upper()}@", str(spec["arena"][side]))
    return text.replace(PLACE, part)


def _for_each_robot(text: str, names: Sequence[str]) -> str:
    """Repeat each line of a part that contains `@ROBOT@` once for each robot.

    `@ROBOT@` becomes the robot's name, and `@I@` its index from 0. A line without `@ROBOT@` occurs
    once, with 0 for `@I@`.
    """
    lines: list[str] = []
    for line in text.splitlines(keepends=True):
        if "@ROBOT@" not in line:
            lines.append(line.replace("@I@", "0"))
            continue
        for i, name in enumerate(names):
            own_line = line.replace("@ROBOT@", name)
            lines.append(own_line.replace("@I@", str(i)))
    return "".join(lines)


def _part(what: str, kind: str) -> str:
    """Return the text of one part of the template, from the folder `robots` or `cameras`.

    A template of tetractl takes precedence over one of the same kind in another package.

    Raises:
        UsageError: If there is no template for this kind.
    """
    parts: dict[str, Path] = {}
    for folder in (OURS, *TEMPLATES.usable().values()):
        for file in sorted((folder / what).glob("*.yaml")):
            parts.setdefault(file.stem, file)
    if kind not in parts:
        raise _no_part(what, kind, list(parts))
    return parts[kind].read_text("utf-8")


def _no_part(what: str, kind: str, parts: list[str]) -> UsageError:
    """Create the error for a kind of robots or cameras that has no part. The caller raises it."""
    option, types = {"robots": ("--robots", ACTUATORS), "cameras": ("--camera", CAMERAS)}[what]
    needs = not_installed(types.group, kind)
    if needs is not None:
        problem, hint = needs
        return UsageError(f"{kind} {problem}", hint)
    why = f"unknown{did_you_mean(kind, parts)}"
    if kind in types:
        why = (
            f"the package of this type has no template {what}/{kind}.yaml; write the "
            "section yourself"
        )
    hint = f"the known types are {', '.join(parts)}; other packages may add more"
    return UsageError(f"{option} {kind}: {why}", hint)
