"""MODELDEF: which rigid body has which id; other data sets are stepped over.

From 4.1 on a data set states its size. Of a rigid body only name and id are read, and the rest is
skipped by that size: Motive 3.4 has descriptions longer than those of 4.3. Before 4.1 a data set
has to be measured; one of a type whose layout is not known ends the reading, and
`ModelDef.complete` says so.
"""

from tetractl.lab.cameras.optitrack.cursor import Cursor
from tetractl.lab.cameras.optitrack.frame import SIZED
from tetractl.lab.cameras.optitrack.natnet_messages import OLDEST, BodyName, ModelDef, Version
from tetractl.lab.lab_errors import WireError

MARKER_SET, RIGID_BODY, SKELETON, FORCE_PLATE, DEVICE, CAMERA = range(6)
_PLATE = (2 + 3 + 12 * 12 + 4 * 3) * 4 + 8  # width, length, origin, matrix, corners, two types


def parse_modeldef(payload: bytes, version: Version) -> ModelDef:
    """Read the rigid bodies' names and ids; those inside skeletons are not listed."""
    if version < OLDEST:
        raise WireError(f"protocol {version} is older than {OLDEST}")
    cursor = Cursor(payload)
    bodies: list[BodyName] = []
    for _ in range(cursor.count(5)):
        kind = cursor.i32()
        if version >= SIZED:
            stop = cursor.at + cursor.size(0, 0) + 4
            if kind == RIGID_BODY:
                bodies.append(_named(Cursor(payload, stop, cursor.at)))
            cursor.skip(stop - cursor.at)
        elif kind == RIGID_BODY:
            bodies.append(_body(cursor, version))
        elif not _step_over(cursor, kind, version):
            return ModelDef(tuple(bodies), complete=False)
    return ModelDef(tuple(bodies))


def _named(cursor: Cursor) -> BodyName:
    """Read name and id, and step over the parent's id."""
    named = BodyName(cursor.name(), cursor.i32())
    cursor.skip(4)
    return named


def _body(cursor: Cursor, version: Version) -> BodyName:
    """Read a body's whole description, of a version that does not state its size."""
    body = _named(cursor)
    cursor.skip(12)
    if version >= (3, 0):
        count = cursor.count(16)
        cursor.skip(count * 16)
        if version >= (4, 0):
            for _ in range(count):
                cursor.name()
    return body


def _step_over(cursor: Cursor, kind: int, version: Version) -> bool:
    if kind == MARKER_SET:
        cursor.name()
    elif kind == SKELETON:
        cursor.name()
        cursor.skip(4)
        for _ in range(cursor.count(21)):
            _body(cursor, version)
        return True
    elif kind == FORCE_PLATE and version >= (3, 0):
        cursor.skip(4)
        cursor.name()
        cursor.skip(_PLATE)
    elif kind == DEVICE and version >= (3, 0):
        cursor.skip(4)
        cursor.name()
        cursor.name()
        cursor.skip(8)
    elif kind == CAMERA:
        cursor.name()
        cursor.skip(28)
        return True
    else:
        return False
    for _ in range(cursor.count(1)):  # names of markers or channels
        cursor.name()
    return True
