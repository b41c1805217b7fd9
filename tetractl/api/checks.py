"""Functions of the Python interface that verify logs, and compare the statistics of batches."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from tetractl.api.logs import as_batch
from tetractl.api.preparation import announcer
from tetractl.core.errors import UsageError, require_type

if TYPE_CHECKING:
    from tetractl.statistics.describe import BatchComparison, BatchStatistics
    from tetractl.statistics.open_batch import Batch
    from tetractl.verification.verify import Verification


def verify(path: str | Path) -> "Verification":
    """Compute every decision in a log again, and check the log for contradictions.

    Args:
        path: The log of one trial.

    Returns:
        The comparison, with every difference. Its attribute `ok` is True if there is none.

    Raises:
        UsageError: If `path` is a folder.

    Example:
        >>> tetractl.verify("logs/cell/trial-000.mcap").ok
        True
    """
    from tetractl.verification import verify

    require_type(path, str | Path, "verify needs the file of a log")
    if Path(path).is_dir():
        raise UsageError(
            f"{path}: this is a folder, but verify reads a single log",
            f"[verify(trial.log) for trial in read_batch({str(path)!r}).trials]",
        )
    return verify.verify(Path(path), announcer(True))


def summarise(
    batch: "Batch | str | Path | Sequence[str | Path]", name: str = ""
) -> "BatchStatistics":
    """Compute the statistics of a batch: errors with intervals, outcomes, the published result.

    Args:
        batch: A batch, its folder, or the paths of its logs.
        name: The batch's name in tables and figures. By default, the experiment's name.

    Raises:
        UsageError: If the trials belong to different experiments.

    Example:
        >>> statistics = tetractl.summarise("logs/cell")
        >>> statistics.total.n
        3
    """
    from tetractl.statistics.describe import describe

    return describe(as_batch(batch), name)


def compare(
    *batches: "BatchStatistics | Batch | str | Path | Sequence[str | Path]",
) -> "BatchComparison":
    """Compare the total errors of every pair of batches.

    Differences are the first batch minus the second. A batch is named after its folder, and
    statistics keep the name that `summarise` gave them.

    Args:
        *batches: Batches, their folders, the paths of their logs, or statistics from `summarise`.

    Raises:
        UsageError: If batches have different length units, or a batch mixes experiments.

    Example:
        >>> small, large = "logs/swarms/small", "logs/swarms/large"
        >>> comparison = tetractl.compare(small, large)
    """
    from tetractl.statistics.describe import BatchStatistics, contrast
    from tetractl.statistics.open_batch import Batch

    compared = list[BatchStatistics]()
    for batch in batches:
        if isinstance(batch, BatchStatistics):
            compared.append(batch)
        elif isinstance(batch, str | Path):
            compared.append(summarise(batch, Path(batch).name))
        elif isinstance(batch, Batch) and len({log.parent for log in batch.logs}) == 1:
            compared.append(summarise(batch, batch.logs[0].parent.name))
        else:
            compared.append(summarise(batch))
    return contrast(compared)
