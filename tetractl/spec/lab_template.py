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
from tetractl.spec.packages import explain_missing
from tetractl.spec.yaml.document import parse_document
from tetractl.spec.yaml.problems import suggest_similar

OWN_TEMPLATES = Path(__file__).parent / "templates"
CAMERA_LINE = "@CAMERA@\n"


def lab_template(robots: str, camera: str | None) -> str:
    """Compose the text of a spec with a lab, for a kind of robots and a kind of camera.

    Args:
        robots: The kind of robots.
        camera: The kind of camera. None for the robots' own camera, or else `optitrack`.

    Raises:
        UsageError: If there is no such part, or if the robots have a camera of their own.
    """
    robots_text = _read_part("robots", robots)
    if CAMERA_LINE not in robots_text:
        if camera not in (None, robots):
            raise UsageError(
                f"robots of type {robots} measure their own poses, so --camera cannot be given",
                "leave --camera out",
            )
        return robots_text
    spec = parse_document(
        robots_text.replace(CAMERA_LINE, "").replace("@NAME@", "name: robots"), robots
    ).data
    names = [robot["name"] for robot in spec["robots"]]
    camera_text = _repeat_lines_for_robots(_read_part("cameras", camera or "optitrack"), names)
    for dimension in ("width", "height"):
        camera_text = camera_text.replace(f"@{dimension.upper()}@", str(spec["arena"][dimension]))
    return robots_text.replace(CAMERA_LINE, camera_text)


def _repeat_lines_for_robots(part_text: str, names: Sequence[str]) -> str:
    """Repeat each line of a part that contains `@ROBOT@` once for each robot.

    `@ROBOT@` becomes the robot's name, and `@I@` its index from 0. A line without `@ROBOT@` occurs
    once, with 0 for `@I@`.
    """
    lines: list[str] = []
    for line in part_text.splitlines(keepends=True):
        if "@ROBOT@" not in line:
            lines.append(line.replace("@I@", "0"))
            continue
        for i, name in enumerate(names):
            own_line = line.replace("@ROBOT@", name)
            lines.append(own_line.replace("@I@", str(i)))
    return "".join(lines)


def _read_part(folder_name: str, kind: str) -> str:
    """Read the text of one part of the template.

    A template of tetractl takes precedence over a template of the same kind in another package.

    Args:
        folder_name: The folder of the part, "robots" or "cameras".
        kind: The kind of robots or camera.

    Raises:
        UsageError: If there is no template for this kind.
    """
    path_by_kind: dict[str, Path] = {}
    for folder in (OWN_TEMPLATES, *TEMPLATES.load_usable().values()):
        for file in sorted((folder / folder_name).glob("*.yaml")):
            path_by_kind.setdefault(file.stem, file)
    if kind not in path_by_kind:
        raise _create_part_error(folder_name, kind, list(path_by_kind))
    return path_by_kind[kind].read_text("utf-8")


def _create_part_error(folder_name: str, kind: str, known_kinds: list[str]) -> UsageError:
    """Create the error for a kind of robots or cameras that has no part. The caller raises it."""
    option, registry = {"robots": ("--robots", ACTUATORS), "cameras": ("--camera", CAMERAS)}[
        folder_name
    ]
    explanation = explain_missing(registry.group, kind)
    if explanation is not None:
        problem, hint = explanation
        return UsageError(f"{kind} {problem}", hint)
    problem_text = f"unknown{suggest_similar(kind, known_kinds)}"
    if kind in registry:
        problem_text = (
            f"the package of this type has no template {folder_name}/{kind}.yaml; write the "
            "section yourself"
        )
    hint = f"the known types are {', '.join(known_kinds)}; other packages may add more"
    return UsageError(f"{option} {kind}: {problem_text}", hint)
