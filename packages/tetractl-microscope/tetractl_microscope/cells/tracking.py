"""Tracks cells through a sequence of images: assigns blobs to tracks and updates their states.

Every object has a track. An object that has not yet swum is a *speck*, which is predicted by its
last motion. A speck that swims becomes a *cell*, with a row in the filter, which predicts the cell
for the known field. `CellTracker.track_image` performs these steps for each image:

1. the filter predicts all cells at the time of the image, and the finder finds the blobs;
2. `match` assigns blobs to tracks: each track has one blob or none, and several cells may share
   one;
3. `readings` converts the blobs to measurements, which update the filter (`filter_update`);
4. `names` infers which cell is which after cells have shared a blob;
5. `newcomers` tracks specks by the blobs without a cell, and those that swim become cells;
6. cells without a blob for too long are dropped, and so are those that do not swim after all.

B is the number of blobs, and K the number of cells in one blob. The place of a blob is x, y [um],
axis [rad], length and width [um], shape (5,). The place of a cell is x, y [um] and axis [rad],
shape (3,).
"""

import bisect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tetractl.core.poses import Floats, GreyImage
from tetractl_microscope.cells import match
from tetractl_microscope.cells.cell import CellAnswer, CellBirth, SeenCell
from tetractl_microscope.cells.cell_tracks import CellTrack, TrackBlob
from tetractl_microscope.cells.detect_cells import Blob, BlobFinder
from tetractl_microscope.cells.filter_update import update_filter
from tetractl_microscope.cells.helix import HEADING, HelixFilter, NearWall, Piece, nowhere_near_wall
from tetractl_microscope.cells.meetings import SPLIT_REACH
from tetractl_microscope.cells.names import CellIdentities
from tetractl_microscope.cells.newcomers import EDGE_ENTRY_LENGTHS, FreeBlob, Newcomers
from tetractl_microscope.cells.picture_now import NewestImage
from tetractl_microscope.cells.readings import (
    BlobReading,
    create_own_reading,
    create_shared_readings,
    record_own_blob,
    update_size,
)
from tetractl_microscope.organisms import TETRAHYMENA, Organism

BLOB_AREAS_MAX = 3.2  # maximum area of a blob, in areas of a large cell, because cells may touch
HIDDEN_S = 0.15  # time without a blob after which a cell is not reported any more
LOST_S = 0.5  # time without a blob after which a cell is lost
# the same near the edge of the image, where the cell has probably left, and for a new cell; this is
# the time for Tetrahymena, and it is longer for slower organisms
LOST_SOON_S = 0.1
NEAR_EDGE_LENGTHS = (
    0.4  # distance to the picture's edge that counts as near, in lengths of the cell
)
NEW_CELL_LENGTHS = 1.15  # distance that a new cell must swim to be accepted [body lengths]
REACH_LENGTHS = (
    0.8  # half side of the square around a cell without background updates [cell lengths]
)
REACH_PX = 4  # margin that is added to this half side [px]

FieldPieces = Callable[[float, float], Sequence[Piece]]
"""Function that returns the field between two times [s] as pieces of constant field."""


@dataclass(frozen=True, slots=True)
class CellsInBlob:
    """A blob of the newest image, and the tracked cells that it shows.

    Attributes:
        track_blob: The blob and its place.
        cells: The K cells.
        expected: Expected x, y [um] and axis [rad] of each cell, shape (K, 3).
    """

    track_blob: TrackBlob
    cells: list[CellTrack]
    expected: Floats


class CellTracker:
    """Tracks the cells in a sequence of microscope images.

    Images must be given in the order of time, after `finder` has learned the background. Positions
    come from `picture_now`.

    Args:
        um_px: Scale of the images [um/px].
        field_known: Whether the field is known.
        near_wall: Function that returns where a wall may turn cells.
        organism: The organism. Its sizes and speeds decide which objects are cells.
    """

    def __init__(
        self,
        um_px: float,
        field_known: bool,
        near_wall: NearWall = nowhere_near_wall,
        organism: Organism = TETRAHYMENA,
    ) -> None:
        area_min_um2 = organism.wide_um[0] * organism.body_um[1]
        area_max_um2 = BLOB_AREAS_MAX * organism.outline_um2[1]
        self.um_px = um_px
        self.finder = BlobFinder(area_min_um2 / um_px**2, area_max_um2 / um_px**2)
        self.answers: Sequence[CellAnswer] = ()  # to questions that the newest picture decided
        self.cell_filter = HelixFilter(field_known, near_wall, organism)
        self._identities = CellIdentities(self.cell_filter, organism.body_um[0])
        self._newcomers = Newcomers(self.cell_filter, self._identities, organism)
        self._cells = list[CellTrack]()  # in the order of their numbers
        self._previous_s: float | None = None  # time of the newest picture

    @property
    def born(self) -> Sequence[CellBirth]:
        """The cells that were recognised for the first time in the newest image."""
        return self._newcomers.born

    def track_image(self, picture: GreyImage, seconds: float, field: FieldPieces) -> list[SeenCell]:
        """Find and track the cells in an image.

        Images must be given in the order of time, after the finder has learned the background.

        Args:
            picture: The image.
            seconds: Its time [s].
            field: Returns the field that acted since the previous image.

        Returns:
            The estimates of all cells that were seen recently.
        """
        image = self._describe_picture(picture, seconds)
        self._predict_cells(image, field)
        blobs = self._find_blobs(picture)
        groups, free_blobs = self._assign_blobs(blobs, image)
        self._update_cells(groups, image)
        self._update_identities(groups, image)
        for cell in self._newcomers.update(free_blobs, self._cells, image):
            bisect.insort(self._cells, cell, key=lambda cell: cell.number)
        self._drop_cells(image)
        self.finder.update_background(self._cell_rectangles(image))
        self._previous_s = seconds
        self.answers = self._identities.take_answers()
        hidden_s = max(HIDDEN_S, image.short_gap_s)
        return self._estimates([cell for cell in self._cells if cell.missed_s < hidden_s])

    # ---- step 1: predict cells, and find blobs ----

    def _describe_picture(self, picture: GreyImage, seconds: float) -> NewestImage:
        """Describe the newest image: its time, the time since the previous one, and its size.

        That time is 0 for the first image.
        """
        height, width = picture.shape
        passed_s = 0.0 if self._previous_s is None else seconds - self._previous_s
        return NewestImage(seconds, passed_s, self.um_px, height, width)

    def _predict_cells(self, image: NewestImage, field: FieldPieces) -> None:
        """Predict the states of the cells from the previous image to the newest.

        Nothing is predicted for the first image.
        """
        pieces = () if self._previous_s is None else field(self._previous_s, image.seconds)
        self.cell_filter.predict(pieces)

    def _find_blobs(self, picture: GreyImage) -> list[Blob]:
        """Find the blobs of an image that are longer than the organism's shortest outline.

        If a knock has shifted the image, all objects are moved with it. The list is empty
        if the light is lost.
        """
        blobs = self.finder.find_blobs(picture)
        light = self.finder.light
        (shortest_um, _), _ = self.cell_filter.organism.outline_um
        columns, rows = light.shift_px
        if columns or rows:
            self._move_objects(columns * self.um_px, -rows * self.um_px)
        if light.lost:
            return []
        return [blob for blob in blobs if blob.length * self.um_px > shortest_um]

    def _move_objects(self, x: float, y: float) -> None:
        """Move all objects by x and y [um], with the content of the image."""
        self.cell_filter.means[:, :2] += x, y
        self._newcomers.move_by(x, y)
        for cell in self._cells:
            cell.move_by(x, y)

    # ---- step 2: assign blobs to tracks ----

    def _assign_blobs(
        self, blobs: Sequence[Blob], image: NewestImage
    ) -> tuple[list[CellsInBlob], list[FreeBlob]]:
        """Assign blobs to cells and specks.

        Returns:
            The blobs that have cells, each with its cells, and the blobs without a cell.
        """
        cells = self._cells
        specks = self._newcomers.specks
        places = image.places_of(blobs)
        organism = self.cell_filter.organism
        expected, covariances = self.cell_filter.predict_bodies(
            np.array([cell.row for cell in cells], int)
        )
        costs = match.compute_cell_costs(
            cells, expected, covariances, blobs, places, image, organism
        )
        speck_costs = match.compute_speck_costs(
            specks, places, image.seconds, image.since_previous_s, organism
        )
        assignment = match.assign_blobs(costs, speck_costs)
        # a cell that has stopped or turned by itself is where the filter does not expect it
        for cell, blob, is_away in zip(cells, assignment.blob_of_cell, costs.is_away, strict=True):
            if blob is not None and is_away[blob]:
                self.cell_filter.widen([cell.row])
        track_blobs = [TrackBlob(index, blob, places[index]) for index, blob in enumerate(blobs)]
        groups = self._assign_to_cells(assignment.blob_of_cell, track_blobs, expected, image)
        return groups, self._assign_to_specks(assignment, track_blobs, image)

    def _assign_to_cells(
        self,
        blob_of_cell: Sequence[int | None],
        track_blobs: Sequence[TrackBlob],
        expected: Floats,
        image: NewestImage,
    ) -> list[CellsInBlob]:
        """Assign blobs to the cells, and return each blob together with its cells.

        `blob_of_cell` contains, for each cell, the index of its blob in `track_blobs`, or None.
        """
        cell_indices_by_blob: dict[int, list[int]] = {}
        for i, blob in enumerate(blob_of_cell):
            if blob is None:
                self._cells[i].newest_blob = None
                self._cells[i].missed_s += image.since_previous_s
            else:
                cell_indices_by_blob.setdefault(blob, []).append(i)
        groups = list[CellsInBlob]()
        for blob, indices in cell_indices_by_blob.items():
            track_blob = track_blobs[blob]
            track_blob.is_shared = len(indices) > 1
            cells = [self._cells[i] for i in indices]
            for cell in cells:
                cell.newest_blob = track_blob
                cell.missed_s = 0.0
            groups.append(CellsInBlob(track_blob, cells, expected[indices]))
        return groups

    def _assign_to_specks(
        self, assignment: match.Assignment, track_blobs: Sequence[TrackBlob], image: NewestImage
    ) -> list[FreeBlob]:
        """Assign blobs to the specks, and return all blobs without a cell.

        A returned blob contains its speck, or None if it belongs to no known speck. For a speck
        without a blob, the time since the previous image is added to the time without a blob.
        """
        speck_by_blob = {}
        for speck, blob in zip(self._newcomers.specks, assignment.blob_of_speck, strict=True):
            if blob is None:
                speck.missed_s += image.since_previous_s
            else:
                speck.missed_s = 0.0
                speck_by_blob[blob] = speck
        with_cells = set(assignment.blob_of_cell)
        return [
            FreeBlob(blob, speck_by_blob.get(blob.index))
            for blob in track_blobs
            if blob.index not in with_cells
        ]

    # ---- step 3: update the states with the blobs ----

    def _update_cells(self, groups: Sequence[CellsInBlob], image: NewestImage) -> None:
        """Update the cells' states with their blobs, after all meetings of cells are known.

        While it is an open question which cell is on a track, several rows of the filter are
        updated.
        """
        for group in groups:
            if group.track_blob.is_shared:
                self._note_meeting(group.cells, image)
        for group in groups:
            if not group.track_blob.is_shared:
                self._note_own_blob(group.cells[0], group.track_blob, image)
        readings = [reading for group in groups for reading in self._measure_cells(group, image)]
        update_filter(
            self.cell_filter, readings, image.seconds, self.cell_filter.organism.body_um[0]
        )
        for reading in readings:
            if not reading.track_blob.is_shared:
                update_size(reading)
            reading.cell.last_um = reading.track_blob.place[:2]

    def _note_own_blob(self, cell: CellTrack, track_blob: TrackBlob, image: NewestImage) -> None:
        """Record the size of a cell's own blob.

        A blob that is cut off or too large may also show another cell.
        """
        record_own_blob(cell, track_blob, image.seconds)
        # at the picture's edge, a cell that enters may take the blob of one that leaves
        is_cut = track_blob.blob.at_edge and not cell.is_new
        if (track_blob.is_large or is_cut) and cell.question is None:
            self._note_meeting([cell], image)

    def _measure_cells(self, group: CellsInBlob, image: NewestImage) -> list[BlobReading]:
        """Convert a blob to the measurements of its cells."""
        body_um = self.cell_filter.organism.body_um[0]
        if group.track_blob.is_shared:
            return create_shared_readings(
                group.cells, group.track_blob, group.expected, image, body_um
            )
        (cell,) = group.cells
        (expected,) = group.expected
        return [create_own_reading(cell, group.track_blob, expected, image, body_um)]

    # ---- step 4: infer which cell is which ----

    def _note_meeting(self, cells: Sequence[CellTrack], image: NewestImage) -> None:
        """Record that cells are not distinguished, and whether an unknown object may join them."""
        self._identities.note_meeting(
            cells, image.seconds, any(self._may_join(cell, image) for cell in cells)
        )

    def _may_join(self, cell: CellTrack, image: NewestImage) -> bool:
        """Check whether an untracked object may be about to enter a cell's blob."""
        if cell.is_new:
            return True
        body_um = self.cell_filter.organism.body_um[0]
        x, y = self.cell_filter.means[cell.row, :2].tolist()
        if image.edge_distance_um(x, y) < EDGE_ENTRY_LENGTHS * body_um:
            return True
        specks = self._newcomers.positions_in_view(image)
        return any(math.dist(speck, (x, y)) < SPLIT_REACH * body_um for speck in specks)

    def _update_identities(self, groups: Sequence[CellsInBlob], image: NewestImage) -> None:
        """End the meetings of cells that are apart again, and close decided questions."""
        places: dict[int, Floats] = {}
        for group in groups:
            for cell in group.cells:
                places[cell.number] = group.track_blob.place[:3]
        self._identities.end_meetings(
            places, self._newcomers.cells_awaiting_specks(), image.seconds
        )
        self._identities.answer_questions(image.seconds)

    # ---- step 6: drop cells ----

    def _drop_cells(self, image: NewestImage) -> None:
        """Drop cells that have not been seen for long, have left the image, or do not swim.

        A new cell does not swim if it has not swum far enough in the time that the slowest cell
        needs. Cells that have swum far enough are no longer new.
        """
        organism = self.cell_filter.organism
        slowest_s = NEW_CELL_LENGTHS * organism.body_um[0] / organism.slowest_um_s
        remaining = list[CellTrack]()
        for cell in self._cells:
            x, y = self.cell_filter.means[cell.row, :2].tolist()
            at_edge = image.edge_distance_um(x, y) < NEAR_EDGE_LENGTHS * cell.size.length
            lost_s = max(LOST_S, image.short_gap_s)
            if at_edge or cell.is_new:
                lost_s = LOST_SOON_S / organism.quickness
            is_lost = cell.missed_s > lost_s
            has_swum = self._has_swum(cell)
            does_not_swim = not has_swum and image.seconds - cell.began_s > slowest_s
            if is_lost or does_not_swim or not math.isfinite(x + y):
                self._identities.forget_track(cell)
                continue
            remaining.append(cell)
            if has_swum:
                cell.start_um = None
        self._cells = remaining

    def _has_swum(self, cell: CellTrack) -> bool:
        """Check whether a cell has swum farther than NEW_CELL_LENGTHS, and so is no longer new.

        A cell that was accepted once is never new again.
        """
        if cell.start_um is None:
            return True
        distance_um = math.dist(cell.last_um.tolist(), cell.start_um.tolist())
        return distance_um > NEW_CELL_LENGTHS * self.cell_filter.organism.body_um[0]

    # ---- results ----

    def _cell_rectangles(self, image: NewestImage) -> list[tuple[int, int, int, int]]:
        """Return rectangles around the cells in which the background is not updated.

        Each rectangle is given by its left, top, right and bottom [px].
        """
        cell_states = self.cell_filter.means[[cell.row for cell in self._cells]]
        rectangles = list[tuple[int, int, int, int]]()
        for cell, (column, row) in zip(
            self._cells, image.pixels_of(cell_states).tolist(), strict=True
        ):
            reach_px = REACH_LENGTHS * cell.size.length / self.um_px + REACH_PX
            first_column = round(column - reach_px)
            last_column = round(column + reach_px)
            first_row = round(row - reach_px)
            last_row = round(row + reach_px)
            rectangles.append((first_column, first_row, last_column, last_row))
        return rectangles

    def _estimates(self, cells: Sequence[CellTrack]) -> list[SeenCell]:
        """Return the estimates of cells in the newest image, in the order of `cells`.

        A cell without a blob in this image has its predicted place.
        """
        rows = np.array([cell.row for cell in cells], int)
        places, _ = self.cell_filter.predict_bodies(rows)
        means = self.cell_filter.means[rows]
        sds = np.sqrt(np.diagonal(self.cell_filter.covariances[rows], axis1=1, axis2=2))
        probabilities = self._identities.probabilities(cells)
        seen_cells = list[SeenCell]()
        for i, cell in enumerate(cells):
            x, y, axis = places[i].tolist()
            track_blob = cell.newest_blob
            shows_others = track_blob is not None and (track_blob.is_shared or track_blob.is_large)
            seen_cells.append(
                SeenCell(
                    identity=cell.identity,
                    track=cell.number,
                    x=x,
                    y=y,
                    axis=axis,
                    heading=float(means[i, HEADING]),
                    mean=means[i],
                    sd=sds[i],
                    probability=probabilities[i],
                    has_blob=track_blob is not None,
                    merged=shows_others,
                    long_um=cell.size.length,
                    wide_um=cell.size.width,
                    blob_um=None if track_blob is None else track_blob.whole_place,
                ).on_blob()
            )
        return seen_cells
