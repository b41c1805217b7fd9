"""The spec with a lab that `tetractl init --lab` writes, of a part for robots and one for cameras.

A part is a file `robots/KIND.yaml` or `cameras/KIND.yaml` of this package or in a folder of the
registry TEMPLATES. That of robots is a spec whose line `@CAMERA@` becomes that of a camera; robots
that measure their own poses have no such line. In a camera's part a line with `@ROBOT@` is repeated
for each robot, which has the number `@I@`, and `@WIDTH@` and `@HEIGHT@` are the arena's.
"""

from pathlib import Path

from tetractl.core.errors import UsageError
from tetractl.core.registries import ACTUATORS, CAMERAS, TEMPLATES
from tetractl.experiment.packages import not_installed
from tetractl.experiment.yaml.document import parse_document
from tetractl.experiment.yaml.problems import did_you_mean

OURS = Path(__file__).parent / "templates"
PLACE = "@CAMERA@\n"


def lab_template(robots: str, camera: str | None) -> str:
    """Return the spec for these kinds of robots and camera, by default the robots' own camera or
    else `optitrack`; UsageError if there is no such part, or the robots have a camera of their own.
    """
    text = _part("robots", robots)
    if PLACE not in text:
        if camera not in (None, robots):
            raise UsageError(f"--robots {robots} measure their own poses", "leave --camera out")
        return text
    whole = text.replace(PLACE, "").replace("@NAME@", "name: robots")
    data = parse_document(whole, robots).data
    names = [robot["name"] for robot in data["robots"]]
    lines = list[str]()
    for line in _part("cameras", camera or "optitrack").splitlines(keepends=True):
        each = enumerate(names) if "@ROBOT@" in line else [(0, "")]
        lines += [line.replace("@ROBOT@", name).replace("@I@", str(i)) for i, name in each]
    part = "".join(lines)
    for side in ("width", "height"):
        part = part.replace(f"@{side.upper()}@", str(data["arena"][side]))
    return text.replace(PLACE, part)


def _part(what: str, kind: str) -> str:
    """Return the text of a part, `robots` or `cameras`."""
    known: dict[str, Path] = {}
    for folder in (OURS, *TEMPLATES.usable().values()):
        for file in sorted((folder / what).glob("*.yaml")):
            known.setdefault(file.stem, file)
    if kind not in known:
        if needs := not_installed(f"tetractl.{what}", kind):
            raise UsageError(f"{kind} {needs[0]}", needs[1])
        option, types = {"robots": ("--robots", ACTUATORS), "cameras": ("--camera", CAMERAS)}[what]
        why = f"unknown{did_you_mean(kind, list(known))}"
        if kind in types:
            why = f"its package brings no template {what}/{kind}.yaml; write the section yourself"
        raise UsageError(
            f"{option} {kind}: {why}",
            f"known are {', '.join(known)}; other packages bring more",
        )
    return known[kind].read_text("utf-8")
