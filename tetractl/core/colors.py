"""The meaning of colours, which is the same in every figure, terminal, page and viewer.

A hue stands for a robot or a cell. Shades of slate stand for batches (arms, controllers, folders)
and for values that belong to no robot, such as a total error. Grey stands for a reference, such as
a limit or a published value. Sand stands for an obstacle, and ALARM for a fault. `view/style.py`
defines how figures draw them, and `report/assets/page.css` how the report does.
"""

from collections.abc import Sequence

GREEN = "#009E73"
BLUE = "#0072B2"
RED = "#D55E00"
PALETTE = (GREEN, BLUE, RED, "#CC79A7", "#E69F00", "#56B4E9", "#8C564B", "#6F4E9C")
"""Colours of the robots.

The first six are the colour-blind safe colours of Okabe and Ito (2008) without yellow and black.
"""
NAMED_COLORS = {"green": GREEN, "blue": BLUE, "red": RED}
"""The paper's colours, which a robot gets by its name, in shades safe for colour-blind readers."""
SLATES = ("#2B3A4A", "#7A8EA3", "#B3C0CC")
"""The colours of batches, from dark to light."""
INK = "#222222"
GREY = "#8A8A8A"
FAINT = "#D0D0D0"
OBSTACLE = "#F6DF8B"
OBSTACLE_EDGE = "#B8960C"
ALARM = "#B00020"


def robot_colors(names: Sequence[str], colors: Sequence[str | None]) -> list[str]:
    """Choose a colour (#rrggbb) in which figures show each robot.

    A robot gets the spec's colour, or else the colour it is named after, or else the next unused
    colour of the palette.

    Args:
        names: Names of the robots.
        colors: The spec's colour for each robot. None if the spec gives none.
    """
    chosen = [_own_color(name, color) for name, color in zip(names, colors, strict=True)]
    unused = [color for color in PALETTE if color not in chosen] or list(PALETTE)
    free_indices = iter(range(len(chosen)))
    return [color or unused[next(free_indices) % len(unused)] for color in chosen]


def _own_color(name: str, color: str | None) -> str | None:
    if color is None:
        return NAMED_COLORS.get(name.lower())
    if color in NAMED_COLORS:
        return NAMED_COLORS[color]
    if color.startswith("#"):
        return color.upper()
    return known_colors()[color]


def known_colors() -> dict[str, str]:
    """Return the colours of CSS, as {name: "#RRGGBB"}."""
    from matplotlib.colors import CSS4_COLORS, to_hex  # slow to import, and only names need it

    return {name: to_hex(color).upper() for name, color in CSS4_COLORS.items()}
