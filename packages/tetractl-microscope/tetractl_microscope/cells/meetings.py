"""Meetings of tracks: infers which track still shows which cell while tracks share a blob.

When a track joins a meeting, the filter row of its cell is copied, and the copy is predicted
without measurements. If the copy of cell n expects the cell at place z of track t with the density
f_n(z_t) [1/um^2], then the assignment of cell s(t) to each track t has the probability

    p(s) ~ product over t of f_s(t)(z_t)

The *own probability* of a track is the sum of p(s) over all s in which the track still has its own
cell. If an untracked object may also have been in the blob, the own probability is multiplied by
f / (f + u), with the density u of an unknown object that comes out of a blob.

The logarithms of densities differ by 11 at most, so their exponentials are finite: f is never
above its peak with the standard deviation POSITION_SD, nor below u times the chance that a cell
turned by itself.

K is the number of tracks, M the number of cells. Places are (K, 3): x, y [um] and axis [rad].
Tables of log-densities [1/um^2] are (K, M): a row for each track, a column for each cell.
"""

import math
from collections.abc import Sequence

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell_tracks import (
    CellTrack,
    Meeting,
    Member,
    compute_log_assignment_probabilities,
    compute_log_densities,
    list_assignments,
    normalise_log_probabilities,
)
from tetractl_microscope.cells.helix import HelixFilter
from tetractl_microscope.cells.readings import SHARED_SD

# Maximum number of tracks for which all assignments of cells are compared.
ASSIGNED_TRACKS_MAX = 4
# Standard deviation of a position, unless it is in a shared blob [lengths of a cell].
POSITION_SD = 0.06
# Maximum distance from a blob at which an object that comes out of it is first seen [lengths].
SPLIT_REACH = 1.5
# Probability that an unknown object was in a blob that it may have entered.
UNKNOWN_PROBABILITY = 0.02


class Meetings:
    """The present meetings of tracks, with a filter row for the cell of each member.

    A meeting owns the filter rows of its members' cells: each row is copied when a track joins, and
    freed when the track leaves or the meeting ends. The tracks' own rows are not changed.

    Args:
        cell_filter: The filter.
        body_um: Length of a cell [um].
    """

    def __init__(self, cell_filter: HelixFilter, body_um: float) -> None:
        self._cell_filter = cell_filter
        self._body_um = body_um
        self._running: list[Meeting] = []

    @property
    def running(self) -> Sequence[Meeting]:
        """The present meetings, in the order in which they began."""
        return tuple(self._running)

    def join(self, tracks: Sequence[CellTrack], with_unknown: bool) -> None:
        """Put tracks into one meeting, together with all tracks that they were already meeting.

        Args:
            tracks: The tracks.
            with_unknown: Whether an unknown object may have joined the meeting.
        """
        meeting = self._merge_meetings(tracks)
        meeting.with_unknown = meeting.with_unknown or with_unknown
        for track in tracks:
            if track not in meeting.tracks:
                self._add_track(meeting, track)
        for track in meeting.tracks:
            track.meeting = meeting

    def _merge_meetings(self, tracks: Sequence[CellTrack]) -> Meeting:
        """Merge all meetings in which the tracks are, or start one if they are in none."""
        meetings = list(
            {id(track.meeting): track.meeting for track in tracks if track.meeting}.values()
        )
        if not meetings:
            meeting = Meeting([], False)
            self._running.append(meeting)
            return meeting
        meeting, *others = meetings
        for merged_meeting in others:
            meeting.members += merged_meeting.members
            meeting.with_unknown = meeting.with_unknown or merged_meeting.with_unknown
            self._running.remove(merged_meeting)
        return meeting

    def _add_track(self, meeting: Meeting, track: CellTrack) -> None:
        """Add a track to a meeting, with a copy of its cell's filter row.

        The copy is predicted without measurements. The track must not be in a meeting
        already.
        """
        row = self._cell_filter.copy_row(track.row)
        meeting.members.append(Member(track, row, track.identity, track.certainty, track.size))

    def leave(self, meeting: Meeting, track: CellTrack) -> None:
        """Remove a track from a meeting. The meeting ends with its last track."""
        (member,) = [member for member in meeting.members if member.track is track]
        meeting.members.remove(member)
        self._release(member)
        if not meeting.members:
            self._running.remove(meeting)

    def end(self, meeting: Meeting) -> None:
        """End a meeting. Its members can still be read, but their filter rows are free."""
        self._running.remove(meeting)
        for member in meeting.members:
            self._release(member)

    def _release(self, member: Member) -> None:
        """Free the filter row of a member that leaves the meeting."""
        self._cell_filter.free_row(member.row)
        member.track.meeting = None

    def own_probabilities(self, meeting: Meeting) -> Floats:
        """Compute the probability that each track of a meeting still shows its own cell, (K,).

        The probability depends on the present places of the cells.
        """
        tracks = meeting.tracks
        places, _ = self._cell_filter.predict_bodies(np.array([track.row for track in tracks]))
        deviations = [SHARED_SD.position if track.is_shared else POSITION_SD for track in tracks]
        log_table = self.compute_log_densities(meeting, places, np.array(deviations))
        known_probabilities = np.diagonal(self.known_probabilities(meeting, log_table))
        if len(tracks) > ASSIGNED_TRACKS_MAX:
            # only exchanges of two cells are counted, as ratios to the assignment without any
            log_own = np.diagonal(log_table)
            exchange_ratios = np.exp(log_table + log_table.T - log_own[:, None] - log_own)
            return known_probabilities / exchange_ratios.sum(axis=1)
        assignments = list_assignments(len(tracks))
        probabilities = normalise_log_probabilities(
            compute_log_assignment_probabilities(assignments, log_table)
        )
        has_own = assignments == np.arange(len(tracks))
        return known_probabilities * (probabilities @ has_own)

    def known_probabilities(self, meeting: Meeting, log_table: Floats) -> Floats:
        """Compute the probability that cells, not an unknown object, are at given places, (K, M).

        The probability is 1 if no unknown object may have joined the meeting. `log_table` (K, M)
        holds the log-densities of the cells at the places.
        """
        if not meeting.with_unknown:
            return np.ones(log_table.shape)
        return 1 / (1 + np.exp(self._log_unknown() - log_table))

    def compute_log_densities(self, meeting: Meeting, places: Floats, deviations: Floats) -> Floats:
        """Compute the log-density of a meeting's cells at given places [1/um^2], shape (K, M).

        Args:
            meeting: The meeting.
            places: The places, shape (K, 3).
            deviations: Additional standard deviations of the places [lengths of a cell], shape
                (K,).
        """
        sd_um = self._body_um * deviations
        return compute_log_densities(
            self._cell_filter, meeting.rows, places, sd_um, self._log_unknown()
        )

    def _log_unknown(self) -> float:
        """Return the log-density of an unknown object that comes out of a blob, in ln of 1/um^2."""
        return math.log(UNKNOWN_PROBABILITY / (math.pi * (SPLIT_REACH * self._body_um) ** 2))
