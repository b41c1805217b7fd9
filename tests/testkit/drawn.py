"""Extracts texts and lines from a figure, by their properties."""

from itertools import combinations

import matplotlib
import numpy as np


def ids_of_unseen_ticks(axes):
    """The texts of marks outside what their axis shows."""
    ids = set()
    for axis, limits in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
            if not axes.axison or not min(limits) <= tick.get_loc() <= max(limits):
                ids |= {id(tick.label1), id(tick.label2)}
    return ids


def shown_texts(figure):
    """The texts of a figure that lie neither outside an axis nor on a trail: words and box."""
    hidden = set()
    for axes in figure.axes:
        hidden |= ids_of_unseen_ticks(axes)
        if axes.get_aspect() == 1:  # an arena, whose texts stand on trails
            hidden |= {id(text) for text in axes.texts}
    texts = figure.findobj(matplotlib.text.Text)
    visible = [text for text in texts if text.get_visible() and id(text) not in hidden]
    return [
        (text.get_text(), matplotlib.text.Text.get_window_extent(text))  # without its arrow
        for text in visible
        if text.get_text().strip()
    ]


def is_beyond(box, page):
    """Whether a box lies more than a pixel beyond the edge of the page."""
    inside = (box.x0 - page.x0, page.x1 - box.x1, box.y0 - page.y0, page.y1 - box.y1)
    return min(inside) < -1


def overlapping(figure):
    """The pairs of texts of a figure that lie over one another, or beyond its edge."""
    figure.draw_without_rendering()
    texts = shown_texts(figure)
    pairs = [(text, "edge") for text, box in texts if is_beyond(box, figure.bbox)]
    for (text, box), (another, another_box) in combinations(texts, 2):
        if another_box.shrunk(0.9, 0.7).overlaps(box):
            pairs.append((another, text))
    return pairs


def words(figure):
    """All text of a figure but the labels of its ticks, which are set when it is drawn."""
    texts = figure.findobj(matplotlib.text.Text)
    return "\n".join(text.get_text() for text in texts if text.get_visible())


def lines(axes, **properties):
    """The lines that have all these properties of matplotlib."""
    return [
        line
        for line in axes.lines
        if all(matplotlib.artist.getp(line, name) == value for name, value in properties.items())
    ]


def end_of(line):
    """The height of a line at its end."""
    return float(np.asarray(line.get_ydata())[-1])
