"""`tetractl lab markers`: the tags of robots and floor as a PDF, to be printed at true size."""

from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tetractl.cli import ui
from tetractl.cli.options import Sets, Spec, option, out_option
from tetractl.core.errors import Exit, UsageError
from tetractl.tools.files import save_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAPERS = {"a4": (210.0, 297.0), "a3": (297.0, 420.0), "letter": (215.9, 279.4)}  # mm
MARGIN_MM = 10.0
LABEL_MM = 6.0
RULER_MM = 100.0
INCH_MM = 25.4
Placed = tuple[float, float, int, float, str]
"""Left and lower end of a card on a page [mm], number and side of its tag [mm], and its label."""


def markers(
    spec: Spec,
    sets: Sets = None,
    out: Annotated[Path, out_option("FILE", "PDF file to write.")] = Path("markers.pdf"),
    paper: Annotated[str, option("NAME", "Paper: a4, a3 or letter.")] = "a4",
) -> int:
    """Write the tags of a spec's robots and floor to a PDF that prints them at their true size.

    Print it without scaling ("actual size"); each page has a ruler of 100 mm to measure. Cut the
    robots' tags out with the white margin, which the camera needs.

    Example: tetractl lab markers shelf.yaml -o markers.pdf
    """
    from tetractl.experiment.plants import lab_of
    from tetractl_microscope.apriltag.section import AprilTagSection

    if paper not in PAPERS:
        raise UsageError(f"--paper {paper}: must be {', '.join(PAPERS)}")
    loaded = ui.load(spec, sets)
    camera = lab_of(loaded.experiment, loaded.name).camera
    if not isinstance(camera, AprilTagSection):
        raise UsageError(
            f"{loaded.name}: lab.camera is of type {camera.type}, which has no tags",
            "a spec with tags: tetractl init NAME --lab --camera apriltag --robots twist",
        )
    tags = [(robot.tag, robot.size_mm, f"robot {robot.name}") for robot in camera.robots]
    tags += [(f.tag, f.size_mm, f"floor, centre at {f.at[0]:g}, {f.at[1]:g}") for f in camera.floor]
    pages = [drawn(PAPERS[paper], page) for page in arranged(PAPERS[paper], tags)]
    save_whole(out, _pdf(pages))
    print(out)
    ui.tell(f"print it without scaling: {len(tags)} tags on {len(pages)} pages of {paper} paper")
    return Exit.DONE


def arranged(
    size: tuple[float, float], tags: Sequence[tuple[int, float, str]]
) -> Iterator[list[Placed]]:
    """Yield the tags of each page of a size [mm], in rows from the top; UsageError if a tag is
    larger than a page."""
    width, height = size
    page: list[Placed] = []
    x = MARGIN_MM
    top = height - MARGIN_MM
    low = height - MARGIN_MM
    for tag, side, label in tags:
        card = side * 1.25  # with a module of white around the eight of the tag
        if card > width - 2 * MARGIN_MM or card > height - 3 * MARGIN_MM - LABEL_MM:
            raise UsageError(f"tag {tag}: {side:g} mm and its margin are larger than the paper")
        if x + card > width - MARGIN_MM:
            x = MARGIN_MM
            top = low
        if top - card - LABEL_MM < 2 * MARGIN_MM:
            yield page
            page = []
            x = MARGIN_MM
            top = height - MARGIN_MM
            low = top
        page.append((x, top - card, tag, side, label))
        x = x + card
        low = min(low, top - card - LABEL_MM)
    yield page


def drawn(size: tuple[float, float], page: Sequence[Placed]) -> "Figure":
    """Return a page of a size [mm] with its tags, labels and ruler, as vectors."""
    from matplotlib.figure import Figure

    width, height = size
    figure = Figure(figsize=(width / INCH_MM, height / INCH_MM))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(0, height))
    axes.set_axis_off()
    for x, y, tag, side, label in page:
        _card(axes, x, y, tag, side)
        axes.text(x, y - 1, f"tag {tag}, {side:g} mm: {label}", fontsize=8, va="top")
    axes.plot((MARGIN_MM, MARGIN_MM + RULER_MM), (MARGIN_MM,) * 2, "k|-", linewidth=0.5)
    axes.text(MARGIN_MM + RULER_MM + 3, MARGIN_MM, "100 mm: measure it", fontsize=8, va="center")
    return figure


def _card(axes: "Axes", x: float, y: float, tag: int, side: float) -> None:
    from matplotlib.patches import Rectangle

    from tetractl_microscope.apriltag.detect import MODULES, tag_picture

    module = side / MODULES
    outer = (MODULES + 2) * module
    axes.add_patch(Rectangle((x, y), outer, outer, fill=False, color="0.8", linewidth=0.2))
    axes.add_patch(Rectangle((x + module, y + module), side, side, color="k", linewidth=0))
    for row, modules in enumerate(tag_picture(tag)):
        for column, grey in enumerate(modules.tolist()):
            if grey:
                corner = x + (1 + column) * module, y + (MODULES - row) * module
                axes.add_patch(Rectangle(corner, module, module, color="w", linewidth=0))


def _pdf(pages: Sequence["Figure"]) -> bytes:
    from matplotlib.backends.backend_pdf import PdfPages

    content = BytesIO()
    with PdfPages(content, metadata={"CreationDate": None}) as file:
        for page in pages:
            file.savefig(page)
    return content.getvalue()
