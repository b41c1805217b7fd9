"""The errors of a study's arms as a table in a terminal."""

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from tetractl.log.read.origin import Origin
from tetractl.stats.text import NONE, lengths, span
from tetractl.study.effect import error_of
from tetractl.study.load import LoadedStudy
from tetractl.study.store import Store
from tetractl.study.table import counted_rows

PLAIN_WIDTH = 1000  # characters; without a terminal no line is wrapped or cut
MOST = 100  # arms that are printed


def print_summary(loaded: LoadedStudy, store: Store, console: Console) -> None:
    """Print n, mean, interval and deviation of the total error of each arm, and what aborted."""
    if not console.is_terminal:
        console = Console(file=console.file, width=PLAIN_WIDTH, color_system=None)
    origins = {row.columns["origin"] for _, row in counted_rows(loaded, store)}
    table = Table(box=box.SIMPLE_HEAD, show_edge=False)
    for name in ("arm", "n", "mean", "95 % interval", "std", "aborted", "what was steered"):
        left = name in ("arm", "what was steered")
        table.add_column(name, justify="left" if left else "right", overflow="fold")
    for arm in loaded.arms[:MOST]:
        rows = [store.rows[arm.name].get(i) for i in range(loaded.study.trials.count)]
        aborted = sum(row is not None and not row.complete for row in rows)
        error = error_of(loaded, store, [arm])
        show = lengths(error.mean)
        cells = (str(error.n), show(error.mean), span(error.ci95, show), show(error.std))
        origin = next((str(row.columns["origin"]) for row in rows if row is not None), NONE)
        table.add_row(Text(arm.name), *cells, str(aborted), origin)
    title = f"{loaded.study.name}: total error [{loaded.unit}]"
    console.print(Text(title, style="bold"))
    if Origin.DISTURBED in origins:
        console.print("disturbances are assumed in the spec, not measured")
    console.print(table)
    if len(loaded.arms) > MOST:
        console.print(f"and {len(loaded.arms) - MOST} arms more, which the table of trials has")
