"""Updates the filter with the measurements from the blobs of an image.

A cell whose identity is an open question has one row of the filter for each cell that it may be.
Its measurement updates all of them, and their likelihoods go to the question. A cell that is often
not where the filter expected it has turned by itself, so its row is made uncertain. If a cell's own
blob is far from the filter's position, the filter restarts at the blob.
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
    """Update the filter with the measurements of one image.

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
    """Add a measurement to an open question of identity.

    Args:
        reading: The measurement.
        question: The question.
        log_likelihoods: Log-likelihood of the measurement for each cell that this one may be, shape
            (K,).
        seconds: Time of the image [s].
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
    """Repair the state of a cell that the filter tracks wrongly.

    Args:
        bank: The filter.
        reading: The measurement of the cell.
        squared_distance: Squared Mahalanobis distance of the blob from the prediction.
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
    """Check whether the filter's position of a cell is too far from the cell's blob.

    It is if they are more than ASTRAY body lengths apart, and if the blob's position is
    precise.
    """
    x, y, _ = reading.values
    state = bank.mean[reading.cell.row, :2].tolist()
    is_certain = reading.deviations[0] < MERGED.position * body_um
    return is_certain and math.dist((x, y), state) > ASTRAY * body_um


def _move_to_blob(bank: HelixFilter, reading: BlobReading) -> None:
    """Move the state of a cell to its blob, with the end of the axis in front that moved ahead."""
    cell = reading.cell
    x, y, axis = reading.values
    last_x, last_y = cell.last.tolist()
    moved_ahead = math.cos(axis) * (x - last_x) + math.sin(axis) * (y - last_y)
    heading = axis + math.pi if moved_ahead < 0 else axis
    row = bank.moved(cell.row, x, y, heading)
    bank.drop(cell.row)
    cell.row = row
