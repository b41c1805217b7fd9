"""The lab's section as it was before cameras and actuators had types of their own.

    lab: {mocap: .., radio: .., protocol: .., robots: .., limits: .., calibration: ..}

becomes

    lab: {camera: {type: optitrack, ..}, actuator: {type: m3pi-xbee, ..}, limits: .., ..}
"""

from collections.abc import Iterator
from typing import Any, TypeGuard, TypeVar

from tetractl.experiment.yaml.core_yaml import dump
from tetractl.experiment.yaml.document import Document
from tetractl.experiment.yaml.problems import Loc

Note = TypeVar("Note")

OF_CAMERA = ("body", "heading_offset")
"""Fields of a robot that went to the camera; the others went to the actuator."""
MOVED_LIMITS: dict[str, Loc] = {
    "connect": ("camera", "connect"),
    "battery_refuse": ("actuator", "battery_refuse"),
    "battery_warn": ("actuator", "battery_warn"),
    "bad_datagrams": ("limits", "damaged_frames"),
}


def is_old_lab(section: Any) -> TypeGuard[dict[str, Any]]:
    """Return whether a section is of the old form; one that mixes both forms is not."""
    if not isinstance(section, dict) or {"camera", "actuator"} & section.keys():
        return False
    return bool({"mocap", "radio", "protocol", "robots"} & section.keys())


def upgrade_lab(section: dict[str, Any]) -> dict[str, Any]:
    """Return an old section in its new form; what cannot be read is kept for the checks to find."""
    new: dict[str, Any] = {}
    if "type" in section:
        new["type"] = section["type"]
    camera: dict[str, Any] = {"type": "optitrack"}
    actuator: dict[str, Any] = {"type": "m3pi-xbee"}
    new |= {"camera": camera, "actuator": actuator}
    for loc, value in _values(section):
        for place in _moved(loc):
            _put(new, place, value)
    for device in (camera, actuator):
        if isinstance(robots := device.get("robots"), dict):
            device["robots"] = list(robots.values())
    return new


def former(loc: Loc) -> Loc:
    """Return where a value of the new form stood in the old one; () where it stood nowhere."""
    for name, moved in MOVED_LIMITS.items():
        if loc == moved:
            return ("limits", name)
    match loc:
        case (("camera" | "actuator"), "robots", *rest):
            return ("robots", *rest)
        case ("actuator", "protocol", *rest):
            return ("protocol", *rest)
        case ("camera",):
            return ("mocap",)
        case ("camera", key, *rest) if key != "type":
            return ("mocap", key, *rest)
        case ("actuator",):
            return ("radio",)
        case ("actuator", key, *rest) if key != "type":
            return ("radio", key, *rest)
        case (("camera" | "actuator"), "type"):
            return ()
    return loc


def _notice(document: Document, place: str, section: dict[str, Any]) -> str:
    """Return what the owner of an old spec should know: the exact new lines of a section."""
    lines = dump({place: section}).rstrip()
    told = f"'{place}' is in the form of an older version; write it so from now on:"
    return f"{document.place((place,)).origin}: {told}\n{lines}"


def upgrade_labs(document: Document) -> None:
    """Bring labs of the old form into the new one; the new lines join the document's notices."""
    for place in ("plant", "lab"):
        section = document.data.get(place)
        if not is_old_lab(section):
            continue
        document.data[place] = new = upgrade_lab(section)
        moved = {(place, *loc): (place, *former(loc)) for loc in _places(new)}
        _move_notes(document.values, place, moved)
        _move_notes(document.keys, place, moved)
        _move_notes(document.refused, place, moved)
        document.notices.append(_notice(document, place, new))


def _move_notes(notes: dict[Loc, Note], place: str, moved: dict[Loc, Loc]) -> None:
    """Put notes on parts of a section to their new places; `moved` gives the old of each new."""
    before = {loc: note for loc, note in notes.items() if loc[:1] == (place,) and loc[1:]}
    for loc in before:
        del notes[loc]
    for new, old in moved.items():
        if old in before:
            notes[new] = before[old]


def _places(value: Any, loc: Loc = ()) -> Iterator[Loc]:
    items = value.items() if isinstance(value, dict) else enumerate(value)
    for step, item in items:
        yield (*loc, step)
        if isinstance(item, dict | list):
            yield from _places(item, (*loc, step))


def is_old_calibration(data: dict[str, Any]) -> bool:
    """Return whether a calibration file lists robots without saying for which device."""
    return isinstance(data.get("robots"), list)


def upgrade_calibration(data: dict[str, Any]) -> dict[str, Any]:
    """Return an old calibration in its new form."""
    new = {key: value for key, value in data.items() if key != "robots"}
    for robot in data["robots"]:
        if not isinstance(robot, dict):
            continue
        for device in ("camera", "actuator"):
            mine = {k: v for k, v in robot.items() if (k in OF_CAMERA) == (device == "camera")}
            entry = {"name": robot.get("name"), **mine}
            new.setdefault(device, {}).setdefault("robots", []).append(entry)
    return new


def _values(section: dict[str, Any]) -> Iterator[tuple[Loc, Any]]:
    """Yield the parts of an old section that move as one."""
    for key, value in section.items():
        if key == "type":
            continue
        if key in ("mocap", "radio", "limits") and isinstance(value, dict):
            for name, item in value.items():
                yield (key, name), item
            if not value:
                yield (key,), value
        elif key == "robots" and isinstance(value, list):
            for i, robot in enumerate(value):
                if isinstance(robot, dict):
                    for name, item in robot.items():
                        yield ("robots", i, name), item
                else:
                    yield ("robots", i), robot
        else:
            yield (key,), value


def _moved(loc: Loc) -> list[Loc]:
    """Return where a part of an old section belongs now."""
    match loc:
        case ("mocap", *rest):
            return [("camera", *rest)] if rest else []
        case ("radio", *rest):
            return [("actuator", *rest)] if rest else []
        case ("protocol",):
            return [("actuator", "protocol")]
        case ("limits", str(name)) if name in MOVED_LIMITS:
            return [MOVED_LIMITS[name]]
        case ("robots", _, "name"):
            return [("camera", *loc), ("actuator", *loc)]
        case ("robots", _, field):
            return [("camera" if field in OF_CAMERA else "actuator", *loc)]
        case ("robots", *_):
            return [("camera", *loc), ("actuator", *loc)]
    return [loc]


def _put(target: dict[Any, Any], loc: Loc, value: Any) -> None:
    """Set a value, making mappings on the way; lists are mappings by index until the end."""
    for step in loc[:-1]:
        target = target.setdefault(step, {})
    target[loc[-1]] = value
