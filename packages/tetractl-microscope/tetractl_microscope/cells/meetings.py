"""Meetings of tracks: who still follows which cell while tracks share a blob.

A copy of each cell's filter row is predicted without measurements from when its track joins. If
such a copy expects cell n at place z of track t with the density f_n(z_t) [1/um^2], then the
assignment of cell s(t) to each track t has the probability

    p(s) ~ product over t of f_s(t)(z_t)

The *share* of a track is the sum of p(s) over all s in which it still has its own cell. If
something that is not followed may have been in the blob, too, the share is multiplied by
f / (f + u), with the density u of something unknown that comes out of a blob.

The logarithms of densities differ by 11 at most, so their exponentials are finite: f is never
above its peak with the deviation PLACE_SD, nor below u times the chance that a cell turned by
itself.

K is the number of tracks, M that of cells. Places are (K, 3): x, y [um] and axis [rad]. Tables of
log-densities [1/um^2] are (K, M): a row for each track, a column for each cell.
"""

import math
from collections.abc import Sequence

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell_tracks import (
    CellTrack,
    Meeting,
    Member,
    log_densities,
    log_of_each,
    normalised,
    orders,
)
from tetractl_microscope.cells.helix import HelixFilter
from tetractl_microscope.cells.readings import MERGED

ORDERED_MOST = 4  # most tracks of which all assignments of cells are compared
PLACE_SD = 0.06  # deviation of a place, unless it is in a shared blob [lengths of a cell]
FROM_BLOB = 1.5  # distance from a blob within which what comes out is first seen [lengths]
UNKNOWN_JOINS = 0.02  # probability that something unknown was in a blob that it may have entered


class Meetings:
    """The meetings that go on. `bank` is the filter, a cell is `body_um` long.

    A meeting owns the filter rows of its members' cells: each is made when a track joins, and freed
    when the track leaves or the meeting ends. The tracks' own rows are not touched.
    """

    def __init__(self, bank: HelixFilter, body_um: float) -> None:
        self._bank = bank
        self._body_um = body_um
        self._running: list[Meeting] = []

    @property
    def running(self) -> Sequence[Meeting]:
        """The present meetings, in the order in which they began."""
        return tuple(self._running)

    def bring(self, together: Sequence[CellTrack], with_unknown: bool) -> None:
        """Put tracks into one meeting, together with all tracks that they were already meeting.

        `with_unknown` tells whether an unknown object may have joined it.
        """
        meeting = self._merged(together)
        meeting.with_unknown = meeting.with_unknown or with_unknown
        for track in together:
            if track not in meeting.tracks:
                self._join(meeting, track)
        for track in meeting.tracks:
            track.meeting = meeting

    def _merged(self, together: Sequence[CellTrack]) -> Meeting:
        """Merge all meetings in which the tracks are, or start one if they are in none."""
        meetings = list({id(t.meeting): t.meeting for t in together if t.meeting}.values())
        if not meetings:
            meeting = Meeting([], False)
            self._running.append(meeting)
            return meeting
        meeting, *merged = meetings
        for ended in merged:
            meeting.members += ended.members
            meeting.with_unknown = meeting.with_unknown or ended.with_unknown
            self._running.remove(ended)
        return meeting

    def _join(self, meeting: Meeting, track: CellTrack) -> None:
        """Add a track to a meeting, with a copy of its cell's filter row.

        The copy is predicted without measurements. The track must not be in a meeting
        already.
        """
        row = self._bank.copied(track.row)
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
        self._bank.drop(member.row)
        member.track.meeting = None

    def own_shares(self, meeting: Meeting) -> Floats:
        """Compute the probability that each track of a meeting still follows the same cell, (K,).

        It depends on where the cells are.
        """
        tracks = meeting.tracks
        places, _ = self._bank.expected(np.array([track.row for track in tracks]))
        deviations = [MERGED.position if track.is_shared else PLACE_SD for track in tracks]
        table = self.log_densities(meeting, places, np.array(deviations))
        not_unknown = np.diagonal(self.not_unknown(meeting, table))
        if len(tracks) > ORDERED_MOST:
            # only exchanges of two cells are counted, as ratios to the assignment without any
            log_own = np.diagonal(table)
            exchanged = np.exp(table + table.T - log_own[:, None] - log_own)
            return not_unknown / exchanged.sum(axis=1)
        order = orders(len(tracks))
        likely = normalised(log_of_each(order, table))
        has_own = order == np.arange(len(tracks))
        return not_unknown * (likely @ has_own)

    def not_unknown(self, meeting: Meeting, table: Floats) -> Floats:
        """Compute the probability that cells are at given places, not an unknown object, (K, M).

        The unknown object may have joined the meeting. `table` holds the cells' log-densities
        there.
        """
        if not meeting.with_unknown:
            return np.ones(table.shape)
        return 1 / (1 + np.exp(self._log_unknown() - table))

    def log_densities(self, meeting: Meeting, places: Floats, deviations: Floats) -> Floats:
        """Compute the log-density of a meeting's cells at given places [1/um^2], shape (K, M).

        Args:
            meeting: The meeting.
            places: The places, shape (K, 3).
            deviations: Additional standard deviations of the places [lengths of a cell], shape
                (K,).
        """
        sd_um = self._body_um * deviations
        return log_densities(self._bank, meeting.rows, places, sd_um, self._log_unknown())

    def _log_unknown(self) -> float:
        """Return the log-density of an unknown object that comes out of a blob, in ln of 1/um^2."""
        return math.log(UNKNOWN_JOINS / (math.pi * (FROM_BLOB * self._body_um) ** 2))
