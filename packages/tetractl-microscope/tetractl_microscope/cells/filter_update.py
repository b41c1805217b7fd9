"""Updates the filter by what the blobs of a picture say of the cells.

A cell with an open question has one row of the filter for each cell that it may be; its reading
updates all of them, and their likelihoods go to the question. A cell that often is where the filter
did not expect it has turned by itself: its row is made uncertain. If its own blob is far away from
where the filter says, the filter follows the blob from now on.
"""

import math
from collections.abc import Sequence

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell import BodySize
from tetractl_microscope.cells.cell_tracks import WhichIsWhich
from tetractl_microscope.cells.helix import HelixFilter
from tetractl_microscope.cells.kernels.helix_steps import ODD_DISTANCE, ODD_RUN
from tetractl_microscope.cells.readings import MERGED, BlobReading

ASTRAY = 0.67  # distance of a cell's state from its own blob above which it is wrong [lengths]


def update_filter(
    bank: HelixFilter, readings: Sequence[BlobReading], seconds: float, body_um: float
) -> None:
    """Update the filter with what an image shows of some cells.

    Args:
        bank: The filter.
        readings: The measurements of the cells.
        seconds: Time of the image [s].
        body_um: Length of a body [um].
    """
    if not readings:
        return
    rows_of = [reading.cell.rows for reading in readings]
    counts = [len(rows) for rows in rows_of]
    log_likelihoods, distances = bank.update(
        np.concatenate(rows_of).astype(int),
        np.repeat([reading.values for reading in readings], counts, axis=0),
        np.repeat([reading.deviations for reading in readings], counts, axis=0),
    )
    last = 0
    for reading, count in zip(readings, counts, strict=True):
        first = last
        last = first + count
        cell = reading.cell
        if cell.question is not None:
            _answer(reading, cell.question, log_likelihoods[first:last], seconds)
        elif not reading.newest.is_shared:
            check_state(bank, reading, float(distances[first]), body_um)


def _answer(
    reading: BlobReading, question: WhichIsWhich, log_likelihoods: Floats, seconds: float
) -> None:
    """Add a blob's measurement to a question.

    That is the log-likelihood of each cell that this one may be (K,), and its size if the blob
    shows the cell alone and completely.
    """
    newest = reading.newest
    size = None
    if not newest.is_shared and not newest.blob.at_edge:
        _, _, _, long, wide = newest.place.tolist()
        size = BodySize(long, wide)
    question.add(reading.cell, log_likelihoods, size, seconds)


def check_state(
    bank: HelixFilter, reading: BlobReading, squared_distance: float, body_um: float
) -> None:
    """Repair the state of a cell that the filter follows wrongly.

    Args:
        bank: The filter.
        reading: The measurement of the cell.
        squared_distance: Squared distance of its blob from where it was expected, in standard
            deviations.
        body_um: Length of a body [um].
    """
    cell = reading.cell
    is_odd = squared_distance > ODD_DISTANCE
    cell.outliers_in_row = cell.outliers_in_row + 1 if is_odd else 0
    if _is_astray(bank, reading, body_um):
        _move_to_blob(bank, reading)
        cell.outliers_in_row = 0
    elif cell.outliers_in_row >= ODD_RUN:
        bank.loosen([cell.row])
        cell.outliers_in_row = 0


def _is_astray(bank: HelixFilter, reading: BlobReading, body_um: float) -> bool:
    """Decide whether the filter's position of a cell is too far away from the cell's blob."""
    x, y, _ = reading.values
    state = bank.mean[reading.cell.row, :2].tolist()
    is_certain = reading.deviations[0] < MERGED.position * body_um
    return is_certain and math.dist((x, y), state) > ASTRAY * body_um


def _move_to_blob(bank: HelixFilter, reading: BlobReading) -> None:
    """Move the state of a cell to its blob; it heads along the axis, the way it has moved."""
    cell = reading.cell
    x, y, axis = reading.values
    last_x, last_y = cell.last.tolist()
    moved_ahead = math.cos(axis) * (x - last_x) + math.sin(axis) * (y - last_y)
    heading = axis + math.pi if moved_ahead < 0 else axis
    row = bank.moved(cell.row, x, y, heading)
    bank.drop(cell.row)
    cell.row = row
