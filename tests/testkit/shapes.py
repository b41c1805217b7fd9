"""Random shapes of every built-in kind, on a grid on which touching and corners occur."""

import math

from hypothesis import strategies as st

from tetractl.model.shapes import Circle, Polygon, Rectangle

GRID = st.integers(-6, 6)
POINTS = st.tuples(GRID, GRID)
L_SHAPE = Polygon(type="polygon", vertices=((0, 0), (4, 0), (4, 1), (1, 1), (1, 3), (0, 3)))


@st.composite
def rectangles(draw):
    width = draw(st.integers(1, 5))
    height = draw(st.integers(1, 5))
    x, y = draw(POINTS)
    return Rectangle(type="rectangle", left=x, bottom=y, width=width, height=height)


@st.composite
def circles(draw):
    return Circle(type="circle", center=draw(POINTS), radius=draw(st.integers(1, 4)))


@st.composite
def stars(draw):
    """Polygons seen whole from one point inside, most of them concave, either way round."""
    count = draw(st.integers(3, 9))
    x, y = draw(POINTS)
    vertices = []
    for i in range(count):
        angle = 2 * math.pi * i / count + 0.1
        radius = draw(st.floats(0.5, 5))
        vertices.append((x + radius * math.cos(angle), y + radius * math.sin(angle)))
    way_round = draw(st.sampled_from([1, -1]))
    return Polygon(type="polygon", vertices=tuple(vertices[::way_round]))


@st.composite
def combs(draw):
    """Polygons with axis-parallel edges on the grid: teeth on a base, as in a micro-arena."""
    x, y = draw(POINTS)
    heights = draw(st.lists(st.integers(1, 4), min_size=1, max_size=4))
    top = []
    for tooth, height in enumerate(heights, x):
        for corner in ((tooth, y + height), (tooth + 1, y + height)):
            if len(top) > 1 and top[-1][1] == top[-2][1] == corner[1]:
                top.pop()
            if not top or top[-1] != corner:
                top.append(corner)
    vertices = [(x + len(heights), y), (x, y), *top]
    return Polygon(type="polygon", vertices=tuple(vertices))


POLYGONS = stars() | combs() | st.just(L_SHAPE)
SHAPES = rectangles() | circles() | POLYGONS
