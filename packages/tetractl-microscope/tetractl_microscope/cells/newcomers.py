"""Tracks specks, which are objects not yet known to be cells, until they swim and become cells.

A blob without a cell continues the speck to which it was assigned, or starts a new speck. A speck
that swims as the organism does becomes a cell, and gets a row of the filter. If it came out of
another cell's blob, `CellIdentities` doubts which of the two is the cell that was tracked.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tetractl_microscope.cells.cell import CellBirth, PathBlob
from tetractl_microscope.cells.cell_tracks import CellTrack, TrackBlob
from tetractl_microscope.cells.helix import HelixFilter
from tetractl_microscope.cells.meetings import SPLIT_REACH
from tetractl_microscope.cells.names import CellIdentities
from tetractl_microscope.cells.picture_now import NewestImage
from tetractl_microscope.cells.readings import PATH_BLOBS
from tetractl_microscope.cells.specks import (
    BLOBS_TO_JUDGE,
    Speck,
    compute_median_size,
    fit_uniform_motion,
    is_swimming,
)
from tetractl_microscope.organisms import Organism

HIDDEN_S = 3.0  # time without a blob for which a speck with a whole path is kept
EDGE_ENTRY_LENGTHS = (
    2.3  # a new cell nearer than this to the picture's edge has swum into it [lengths]
)


@dataclass(frozen=True, slots=True)
class FreeBlob:
    """A blob in the newest image that shows no tracked cell.

    Attributes:
        track_blob: The blob.
        speck: The speck to which it was assigned. None for an object that was not seen before.
    """

    track_blob: TrackBlob
    speck: Speck | None

    def path_entry(self, seconds: float) -> PathBlob:
        """Convert the blob to an entry of a cell's path at a time [s].

        Its size is NaN if the image's edge cuts it off.
        """
        x, y, axis, length, width = self.track_blob.place.tolist()
        if self.track_blob.blob.at_edge:
            return PathBlob(seconds, x, y, axis, math.nan, math.nan)
        return PathBlob(seconds, x, y, axis, length, width)


class Newcomers:
    """The specks of a dish: objects that become cells once they swim.

    For each image, `update` is called once, after the cells have their blobs and names.

    Args:
        cell_filter: The filter of the cells.
        identities: The names of the cells.
        organism: What the cells are.
    """

    def __init__(
        self, cell_filter: HelixFilter, identities: CellIdentities, organism: Organism
    ) -> None:
        self.specks = list[Speck]()
        self.born = list[CellBirth]()  # the cells that began in the newest picture
        self._cell_filter = cell_filter
        self._identities = identities
        self._organism = organism
        self._body_um = organism.body_um[0]
        self._last_number = 0  # of the newest track

    def move_by(self, x: float, y: float) -> None:
        """Move the specks by x and y [um], with the content of the image."""
        for speck in self.specks:
            speck.move_by(x, y)

    def update(
        self, free_blobs: Sequence[FreeBlob], cells: Sequence[CellTrack], image: NewestImage
    ) -> list[CellTrack]:
        """Track specks with the blobs that belong to no cell.

        Args:
            free_blobs: The blobs.
            cells: The tracked cells.
            image: The newest image.

        Returns:
            The cells that specks have become.
        """
        self.born = []
        cell_positions_um = np.array(
            [self._cell_filter.means[cell.row, :2] for cell in cells]
        ).reshape(-1, 2)
        new_cells = list[CellTrack]()
        for free_blob in free_blobs:
            distances_um = np.linalg.norm(
                cell_positions_um - free_blob.track_blob.place[:2], axis=1
            )
            nearest_um = float(distances_um.min(initial=np.inf))
            speck = free_blob.speck
            if speck is None:
                is_near = nearest_um < SPLIT_REACH * self._body_um
                nearest_cell = cells[int(distances_um.argmin())] if is_near else None
                self._last_number += 1
                path = [free_blob.path_entry(image.seconds)]
                self.specks.append(Speck(self._last_number, path, nearest_cell))
                continue
            was_hidden = image.seconds - speck.path[-1].seconds > image.short_gap_s
            earlier_path = [] if was_hidden else speck.path[1 - PATH_BLOBS :]
            speck.path = [*earlier_path, free_blob.path_entry(image.seconds)]
            if is_swimming(speck.path, self._organism):
                cell = self._turn_into_cell(speck, free_blob.track_blob, cells, image)
                new_cells.append(cell)
        self._drop_hidden(image)
        return new_cells

    def _drop_hidden(self, image: NewestImage) -> None:
        """Drop specks that were hidden for HIDDEN_S, or for `brief_s` if their path is short."""
        remaining = list[Speck]()
        for speck in self.specks:
            has_whole_path = len(speck.path) == PATH_BLOBS
            if speck.missed_s <= (HIDDEN_S if has_whole_path else image.short_gap_s):
                remaining.append(speck)
        self.specks = remaining

    def positions_in_view(self, image: NewestImage) -> list[tuple[float, float]]:
        """Return the last position x, y [um] of each speck that is in view.

        A speck counts as in view until it has had no blob for `brief_s` seconds.
        """
        newest = [speck.path[-1] for speck in self.specks if speck.missed_s < image.short_gap_s]
        return [(blob.x, blob.y) for blob in newest]

    def cells_awaiting_specks(self) -> list[CellTrack]:
        """Return the cells near which a speck was first seen that may still become a cell.

        A cell appears once for each such speck.
        """
        return [
            speck.first_near
            for speck in self.specks
            if speck.first_near is not None and len(speck.path) <= BLOBS_TO_JUDGE
        ]

    # ---- a cell begins ----

    def _turn_into_cell(
        self, speck: Speck, newest_blob: TrackBlob, cells: Sequence[CellTrack], image: NewestImage
    ) -> CellTrack:
        """Turn a speck that swims into a cell.

        Args:
            speck: The speck.
            newest_blob: Its newest blob.
            cells: The existing cells.
            image: The newest image.
        """
        path = np.array(speck.path)
        (speed_x, speed_y), fitted = fit_uniform_motion(path[-BLOBS_TO_JUDGE:])
        x, y = fitted[-1].tolist()
        heading = math.atan2(speed_y, speed_x)
        cell = CellTrack(
            number=speck.number,
            row=self._cell_filter.add(x, y, heading, math.hypot(speed_x, speed_y)),
            size=compute_median_size(path),
            last_um=path[-1, 1:3],
            path=speck.path,
            newest_blob=newest_blob,
            size_seen_s=image.seconds,
            start_um=np.array((x, y)),
            began_s=image.seconds,
            identity=self._identities.new_identity(),
        )
        mother = None
        if speck.first_near is not None and speck.first_near in cells:
            since_s, first_x, first_y = path[0, :3].tolist()
            has_entered = (
                image.edge_distance_um(first_x, first_y) < EDGE_ENTRY_LENGTHS * self._body_um
            )
            mother = self._identities.note_split(cell, speck.first_near, since_s, has_entered)
        self.specks.remove(speck)
        self.born.append(
            CellBirth(
                identity=cell.identity,
                track=cell.number,
                mother=mother,
            )
        )
        return cell
