"""`tetractl lab markers`: writes a PDF of the tags for robots and floor, to print at true size."""

from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from tetractl.cli import ui
from tetractl.cli.options import Sets, Spec, option, out_option
from tetractl.core.errors import Exit, UsageError
from tetractl.tools.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPERS = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}  # mm
MARGIN_MM = 10.0
LABEL_HEIGHT_MM = 6.0
RULER_MM = 100.0
INCH_MM = 25.4
ARROW_MODULES = 0.3
"""Length of the arrow on a card, from its centre, in modules of the tag."""
FONT_MODULES = 0.45
"""Font size of the word beside the arrow, in modules: "front" is then 1.2 modules long."""


class Card(NamedTuple):
    """A printed card: a tag with its white margin.

    Attributes:
        tag: Number of the tag.
        side_mm: Side of the tag's black square [mm].
        label: What is printed below the card.
        points_to: What the arrow on the card points to.
        angle: Direction of the arrow, from the direction in which the tag is read [rad].
    """

    tag: int
    side_mm: float
    label: str
    points_to: str = "front"
    angle: float = 0.0


PlacedCard = tuple[float, float, Card]
"""x of the left edge and y of the lower edge of a card on a page [mm], and the card."""


def markers(
    spec: Spec,
    sets: Sets = None,
    out: Annotated[Path, out_option("FILE", "PDF file to write.")] = Path("markers.pdf"),
    paper: Annotated[str, option("NAME", "Paper size: a4, a3 or letter.")] = "a4",
) -> int:
    """Write the tags of a spec's robots and floor to a PDF that prints them at their true size.

    Print it without scaling ("actual size"); each page has a ruler of 100 mm to measure. Cut the
    robots' tags out with the white margin, which the camera needs. The arrow on a robot's tag
    points to the robot's front, the arrow on a floor tag along the spec's x axis.

    Example: tetractl lab markers shelf.yaml -o markers.pdf
    """
    from tetractl.spec.plants import get_lab
    from tetractl_microscope.apriltag.section import AprilTagSection

    if paper not in PAPERS:
        raise UsageError(f"--paper {paper}: must be {', '.join(PAPERS)}")
    loaded = ui.load_spec_file(spec, sets)
    camera = get_lab(loaded.experiment, loaded.name).camera
    if not isinstance(camera, AprilTagSection):
        raise UsageError(
            f"{loaded.name}: lab.camera has type {camera.type}, which uses no tags",
            "this command writes a spec whose camera uses tags: tetractl init NAME --lab "
            "--camera apriltag --robots twist",
        )
    cards = [
        Card(tag.tag, tag.size_mm, f"robot {tag.name}", "front", tag.heading_offset)
        for tag in camera.robots
    ]
    cards += [
        Card(
            tag.tag,
            tag.size_mm,
            f"floor, centre at {tag.at[0]:g}, {tag.at[1]:g}",
            "x",
            -tag.heading,
        )
        for tag in camera.floor
    ]
    pages = [draw_page(PAPERS[paper], page) for page in arrange_cards(PAPERS[paper], cards)]
    write_atomically(out, _format_pdf(pages))
    print(out)
    ui.print_messages(
        f"wrote {len(cards)} tags on {len(pages)} pages of {paper} paper; print them "
        "without scaling"
    )
    return Exit.DONE


def arrange_cards(size: tuple[float, float], cards: Sequence[Card]) -> Iterator[list[PlacedCard]]:
    """Yield the cards of each page of a given size [mm], in rows from the top.

    Raises:
        UsageError: If a tag is larger than a page.
    """
    width, height = size
    page: list[PlacedCard] = []
    x = MARGIN_MM
    row_top = height - MARGIN_MM
    row_bottom = height - MARGIN_MM
    for card in cards:
        card_mm = card.side_mm * 1.25  # with a module of white around the eight of the tag
        if card_mm > width - 2 * MARGIN_MM or card_mm > height - 3 * MARGIN_MM - LABEL_HEIGHT_MM:
            problem = f"the tag of {card.side_mm:g} mm and its margin do not fit on the paper"
            raise UsageError(f"tag {card.tag}: {problem}")
        if x + card_mm > width - MARGIN_MM:
            x = MARGIN_MM
            row_top = row_bottom
        if row_top - card_mm - LABEL_HEIGHT_MM < 2 * MARGIN_MM:
            yield page
            page = []
            x = MARGIN_MM
            row_top = height - MARGIN_MM
            row_bottom = row_top
        page.append((x, row_top - card_mm, card))
        x = x + card_mm
        row_bottom = min(row_bottom, row_top - card_mm - LABEL_HEIGHT_MM)
    yield page


def draw_page(size: tuple[float, float], page: Sequence[PlacedCard]) -> "Figure":
    """Draw a page of a size (width, height) [mm] with its tags, labels and ruler, as vectors.

    Positions on the page are counted from its lower left corner [mm].
    """
    from matplotlib.figure import Figure

    width, height = size
    figure = Figure(figsize=(width / INCH_MM, height / INCH_MM))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(0, height))
    axes.set_axis_off()
    for x, y, card in page:
        _draw_tag(axes, x, y, card)
        _draw_arrow(axes, x, y, card)
        label = f"tag {card.tag}, {card.side_mm:g} mm: {card.label}"
        axes.text(x, y - 1, label, fontsize=8, va="top")
    axes.plot((MARGIN_MM, MARGIN_MM + RULER_MM), (MARGIN_MM,) * 2, "k|-", linewidth=0.5)
    axes.text(MARGIN_MM + RULER_MM + 3, MARGIN_MM, "100 mm: measure it", fontsize=8, va="center")
    return figure


def _draw_tag(axes: "Axes", x: float, y: float, card: Card) -> None:
    from matplotlib.patches import Rectangle

    from tetractl_microscope.apriltag.detect import MODULES, tag_picture

    side_mm = card.side_mm
    module_mm = side_mm / MODULES
    card_mm = (MODULES + 2) * module_mm
    axes.add_patch(Rectangle((x, y), card_mm, card_mm, fill=False, color="0.8", linewidth=0.2))
    axes.add_patch(
        Rectangle((x + module_mm, y + module_mm), side_mm, side_mm, color="k", linewidth=0)
    )
    for row, modules in enumerate(tag_picture(card.tag)):
        for column, grey in enumerate(modules.tolist()):
            if grey:
                corner = x + (1 + column) * module_mm, y + (MODULES - row) * module_mm
                axes.add_patch(Rectangle(corner, module_mm, module_mm, color="w", linewidth=0))


def _draw_arrow(axes: "Axes", x: float, y: float, card: Card) -> None:
    """Draw an arrow with a label beside the top right corner of a tag.

    There the detector does not look for the edges of the tag, so that its corners stay exact.
    """
    import numpy as np
    from matplotlib.patches import Polygon

    from tetractl_microscope.apriltag.detect import MODULES

    module_mm = card.side_mm / MODULES
    centre = np.array([x, y]) + (MODULES + 1.5) * module_mm
    angles = card.angle + np.array([0.0, 2.5, -2.5])  # of the tip and of the two other ends [rad]
    corners = centre + ARROW_MODULES * module_mm * np.column_stack([np.cos(angles), np.sin(angles)])
    axes.add_patch(Polygon(corners, color="k", linewidth=0))
    axes.text(
        centre[0] - 0.45 * module_mm,
        centre[1],
        card.points_to,
        fontsize=FONT_MODULES * module_mm * 72 / INCH_MM,
        ha="right",
        va="center",
    )


def _format_pdf(pages: Sequence["Figure"]) -> bytes:
    from matplotlib.backends.backend_pdf import PdfPages

    content = BytesIO()
    with PdfPages(content, metadata={"CreationDate": None}) as file:
        for page in pages:
            file.savefig(page)
    return content.getvalue()
