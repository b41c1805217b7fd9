"""Updates the Kalman filter of the cells with measurements from the blobs of an image.

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
from tetractl_microscope.cells.cell_tracks import IdentityQuestion
from tetractl_microscope.cells.helix import HelixFilter
from tetractl_microscope.cells.kernels.helix_steps import DISTANT_COUNT, DISTANT_SQUARED
from tetractl_microscope.cells.readings import SHARED_SD, BlobReading

ASTRAY_LENGTHS = (
    0.67  # distance of a cell's state from its own blob above which it is wrong [lengths]
)


def update_filter(
    cell_filter: HelixFilter, readings: Sequence[BlobReading], seconds: float, body_um: float
) -> None:
    """Update the Kalman filter of the cells with the measurements of one image.

    Args:
        cell_filter: The filter.
        readings: The measurements of the cells.
        seconds: Time of the image [s].
        body_um: Length of a body [um].
    """
    if not readings:
        return
    rows_of = [reading.cell.rows for reading in readings]
    counts = [len(rows) for rows in rows_of]
    log_likelihoods, squared_distances = cell_filter.update(
        np.concatenate(rows_of).astype(int),
        np.repeat([reading.values for reading in readings], counts, axis=0),
        np.repeat([reading.deviations for reading in readings], counts, axis=0),
    )
    stop = 0
    for reading, count in zip(readings, counts, strict=True):
        start = stop
        stop = start + count
        cell = reading.cell
        if cell.question is not None:
            _add_to_question(reading, cell.question, log_likelihoods[start:stop], seconds)
        elif not reading.track_blob.is_shared:
            repair_state(cell_filter, reading, float(squared_distances[start]), body_um)


def _add_to_question(
    reading: BlobReading, question: IdentityQuestion, log_likelihoods: Floats, seconds: float
) -> None:
    """Use a measurement as evidence for which cell is on which track.

    Args:
        reading: The measurement.
        question: The question.
        log_likelihoods: Log-likelihood of the measurement for each cell that this one may be, shape
            (K,).
        seconds: Time of the image [s].
    """
    track_blob = reading.track_blob
    size = None
    if not track_blob.is_shared and not track_blob.blob.at_edge:
        _, _, _, length, width = track_blob.place.tolist()
        size = BodySize(length, width)
    question.add_measurement(reading.cell, log_likelihoods, size, seconds)


def repair_state(
    cell_filter: HelixFilter, reading: BlobReading, squared_distance: float, body_um: float
) -> None:
    """Repair the state of a cell that the filter tracks wrongly.

    Args:
        cell_filter: The filter.
        reading: The measurement of the cell.
        squared_distance: Squared Mahalanobis distance of the blob from the prediction.
        body_um: Length of a body [um].
    """
    cell = reading.cell
    is_distant = squared_distance > DISTANT_SQUARED
    cell.outliers_in_row = cell.outliers_in_row + 1 if is_distant else 0
    if _is_astray(cell_filter, reading, body_um):
        _move_to_blob(cell_filter, reading)
        cell.outliers_in_row = 0
    elif cell.outliers_in_row >= DISTANT_COUNT:
        cell_filter.widen([cell.row])
        cell.outliers_in_row = 0


def _is_astray(cell_filter: HelixFilter, reading: BlobReading, body_um: float) -> bool:
    """Check whether the filter's position of a cell is too far from the cell's blob.

    The position counts as wrong if it is more than ASTRAY_LENGTHS body lengths from the blob, and
    if the blob's position is precise.
    """
    x, y, _ = reading.values
    state = cell_filter.means[reading.cell.row, :2].tolist()
    is_certain = reading.deviations[0] < SHARED_SD.position * body_um
    return is_certain and math.dist((x, y), state) > ASTRAY_LENGTHS * body_um


def _move_to_blob(cell_filter: HelixFilter, reading: BlobReading) -> None:
    """Move the state of a cell to its blob, and choose the end that moves ahead as the front."""
    cell = reading.cell
    x, y, axis = reading.values
    last_x, last_y = cell.last_um.tolist()
    moved_ahead = math.cos(axis) * (x - last_x) + math.sin(axis) * (y - last_y)
    heading = axis + math.pi if moved_ahead < 0 else axis
    row = cell_filter.copy_row_to(cell.row, x, y, heading)
    cell_filter.free_row(cell.row)
    cell.row = row
