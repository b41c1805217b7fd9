"""Plain functions compiled in single precision stay in it: one float64 halves their speed."""

import pytest
from numba import types

from tetractl.control.kernels.options import inlined
from tetractl.model.motion.arc import ArcLanes
from tetractl.model.motion.euler import EulerLanes, EulerSmallTurnLanes
from tetractl.model.motion.exact import ExactSingleLanes
from tetractl.model.motion.polynomials import sincos
from tetractl.model.shapes.circle import PackedCircles
from tetractl.model.shapes.half_plane import PackedHalfPlanes
from tetractl.model.shapes.rectangle import PackedRectangles


def returned(function, *arguments):
    dispatcher = inlined(function, types.float32)
    dispatcher.compile(arguments)
    kept = dispatcher.overloads[arguments].signature.return_type
    return set(kept) if isinstance(kept, types.BaseTuple) else {kept}


def numbers(count):
    return [types.float32] * count


def row(kind):
    return types.UniTuple(types.float32, kind.size)


def test_sines():
    assert returned(sincos, types.float32) == {types.float32}


@pytest.mark.parametrize("kind", [ArcLanes, EulerLanes, EulerSmallTurnLanes, ExactSingleLanes])
def test_motions(kind):
    assert returned(kind.advance, *numbers(6), row(kind)) == {types.float32}


@pytest.mark.parametrize("kind", [PackedRectangles, PackedCircles, PackedHalfPlanes])
def test_shapes(kind):
    assert returned(kind.gap, *numbers(2), row(kind)) == {types.float32}
    assert returned(kind.gap_between, *numbers(4), row(kind)) == {types.float32}
