"""Infers which cell is which after cells have met, was lost, or came out of another one's blob.

While cells share a blob, copies of their filter rows are predicted without measurements. Where the
cells then are says which is which with some probability, which the question begins with: each track
is followed by one filter row per cell that it may be, with that cell's turning rate, bias, speed
and helix, and the likelihoods of later measurements, above all of the response to the field, give
the probability of each assignment. A question ends once one assignment is certain, or after a time.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell import CellAnswer
from tetractl_microscope.cells.cell_tracks import (
    CellTrack,
    Known,
    Meeting,
    WhichIsWhich,
    log_densities,
    normalised,
    orders,
    return_density,
)
from tetractl_microscope.cells.helix import HEADING, HelixFilter
from tetractl_microscope.cells.readings import MERGED

TOGETHER = 4  # most tracks whose identities are resolved together
LIKELIER = 0.5  # least probability with which a cell that appears is taken for a lost one
ASSERTED = 0.99  # probability above which no question is asked, and a name is called sure
PASSED_ON = 0.9  # least probability with which a film goes on with a name
FIRST = (2.0, 2.0, 0.1)  # standard deviations of a track's first blob in a question: um, um, rad
FAR = 25.0  # squared distance, in standard deviations, above which a cell is moved to its track
PLACE = 0.06  # deviation of a place, unless it is in a shared blob [lengths of a cell]
FROM = 1.5  # distance from a blob within which what comes out of it is first seen [lengths]
EITHER = 0.02  # probability that something unknown has been in a blob that it may have entered
REMEMBERED_S = 0.5  # time for which a meeting with something unknown is remembered
LOST_S, LOST = 3.0, 16  # time for which a lost cell can come back; most cells remembered


class Names:
    """Knows which tracks are together, which questions are open, and which cells are lost.

    `bank` is the filter, a cell is `body_um` long. If a film's table `splits` names, a track whose
    cell is too uncertain when a question ends gets a new name instead of an asserted one.
    """

    def __init__(self, bank: HelixFilter, body_um: float, splits: bool) -> None:
        self._bank, self._body_um, self._splits, self._last = bank, body_um, splits, 0
        self._meetings: list[Meeting] = []
        self._questions: list[WhichIsWhich] = []
        self._lost: list[Known] = []
        self.answers: list[CellAnswer] = []  # since the tracker last emptied the list

    def number(self) -> int:
        """Return a new cell's number."""
        self._last += 1
        return self._last

    def meet(self, together: Sequence[CellTrack], seconds: float, met: bool) -> None:
        """Record that tracks are not distinguished at a time [s]: they share a blob, or that of a
        single one is too large. `met` is whether something unknown may be with them.
        """
        for question in {id(t.question): t.question for t in together if t.question}.values():
            self._end(question)
        meetings = list({id(t.meeting): t.meeting for t in together if t.meeting}.values())
        meeting = meetings[0] if meetings else Meeting([], [], met)
        if not meetings:
            self._meetings.append(meeting)
        for other in meetings[1:]:
            meeting.tracks += other.tracks
            meeting.cells += other.cells
            meeting.met |= other.met
            self._meetings.remove(other)
        meeting.met |= met
        for track in together:
            track.together_s = seconds
            if track not in meeting.tracks:
                meeting.tracks.append(track)
                row, size = self._bank.copied(track.filter_row), (track.long, track.wide)
                meeting.cells.append(Known(track.identity, row, track.certainty, size))
        for track in meeting.tracks:
            track.meeting = meeting

    def part(self, places: dict[int, Floats], awaited: Sequence[CellTrack], seconds: float) -> None:
        """End the meetings of tracks that are apart again; `places` gives x, y [um] and axis [rad]
        of the blob of each track. Something new, which may prove to be a cell, was first seen near
        the tracks `awaited`.
        """
        for meeting in list(self._meetings):
            tracks = meeting.tracks
            waits = len(tracks) == 1 or any(track in awaited for track in tracks)
            wait_s = REMEMBERED_S if waits else 0.0
            apart = [t for t in tracks if t.number in places and t.together_s < seconds - wait_s]
            if not apart:
                continue
            shares = self._stay(meeting)
            for track, share in zip(list(tracks), shares.tolist(), strict=True):
                if len(shares) > 1 and meeting.met and any(t not in apart for t in tracks):
                    share = min(share, ASSERTED)
                if track in apart and (share > ASSERTED or len(shares) == 1):
                    self._leave(meeting, track)
                    if share < ASSERTED:
                        self._doubt(track, share)
            if not tracks:
                self._forget(meeting)
            elif all(track in apart for track in tracks):
                if len(tracks) <= TOGETHER:
                    self._part(meeting, np.array([places[t.number] for t in tracks]), seconds)
                    continue
                shares = self._stay(meeting)
                self._forget(meeting)
                for track, share in zip(tracks, shares.tolist(), strict=True):
                    self._doubt(track, share)

    def appear(
        self, track: CellTrack, place: Floats, since_s: float, expected: float, entered: bool
    ) -> int | None:
        """Name a new cell, first seen at a time [s], that is at x, y [um] and axis [rad] (3,).

        The cell may be a lost one: `expected` [1/um^2] is the density of cells that appear there
        otherwise. If it comes out of the blob of `track.near`, it is uncertain which of the two is
        the cell that was followed. Unless something unknown may have been in that blob, or the cell
        may have `entered` the picture, the number of the cell that has divided there is returned;
        None if none has.
        """
        near, divided = track.near, None
        meeting = None if near is None else near.meeting
        if near is not None and (meeting is None or len(meeting.tracks) == 1):
            if meeting is not None and meeting.met:
                here, _ = self._bank.expected(np.array([near.filter_row, track.filter_row]))
                own, other = self._table(meeting.cells, here, np.full(2, PLACE))[:, 0].tolist()
                near.together_s = since_s
                self._forget(meeting)
                self._doubt(near, 1 / (1 + math.exp(other - own)))
            elif not entered and near.question is None:
                divided, near.together_s = near.identity, since_s
                self._doubt(near, 0.5)
        if divided is None and self._lost:
            seen = place[:2], np.array([track.long, track.wide]), since_s, self._body_um
            weights = [return_density(self._bank, one, *seen) for one in self._lost]
            i = int(np.argmax(weights))
            probability = weights[i] / (sum(weights) + expected)
            if probability > (PASSED_ON if self._splits else LIKELIER):
                lost = self._lost.pop(i)
                self._bank.drop(track.filter_row)
                track.row = self._bank.moved(lost.filter_row, *place.tolist())
                track.identity, track.certainty = lost.name, lost.certainty * probability
                track.long, track.wide = lost.size
                self._drop([lost])
        return divided

    def answer(self, seconds: float) -> None:
        """Give tracks their names by the likeliest answers; end the questions that are decided, and
        forget cells that were lost too long ago.
        """
        while self._lost and (len(self._lost) > LOST or seconds - self._lost[0].lost_s > LOST_S):
            self._drop([self._lost.pop(0)])
        for question in list(self._questions):
            order, _ = question.best()
            for t, track in enumerate(question.tracks):
                track.identity = question.cells[order[t]].name
                track.row = int(question.rows[t, order[t]])
            if question.ends(seconds):
                self._end(question)

    def finish(self, seconds: float) -> None:
        """End all meetings and questions: there are no pictures after this time [s]."""
        for meeting in list(self._meetings):
            if len(meeting.tracks) > 1:
                likely = self.probabilities(meeting.tracks)
                for track, probability in zip(list(meeting.tracks), likely, strict=True):
                    if track.together_s < seconds:
                        self._doubt(track, probability)
            self._forget(meeting)
        for question in list(self._questions):
            self._end(question)

    def probabilities(self, tracks: Sequence[CellTrack]) -> list[float]:
        """Return the probability, for each of some tracks, that it has the right name."""
        known: dict[int, float] = {}  # by track
        for question in self._questions:
            order, shares = question.best()
            for t, track in enumerate(question.tracks):
                known[track.number] = float(shares[t] * question.cells[order[t]].certainty)
        for meeting in self._meetings:
            shares = self._stay(meeting)
            for track, share in zip(meeting.tracks, shares.tolist(), strict=True):
                if track.question is None:
                    known[track.number] = track.certainty * share
        return [known.get(track.number, track.certainty) for track in tracks]

    def give_up(self, track: CellTrack, seconds: float, may_return: bool) -> None:
        """Forget a track at a time [s]; its cell is lost if it `may_return`. If only one track is
        left in the blob that both have shared, it is uncertain which of the cells that is.
        """
        if track.question is not None:
            self._end(track.question)
        if track.meeting is not None:
            meeting, shares = track.meeting, self._stay(track.meeting).tolist()
            likely = [each for each in zip(meeting.tracks, shares, strict=True) if each[0] != track]
            self._leave(meeting, track)
            if len(likely) == 1 and likely[0][1] < ASSERTED:
                self._forget(meeting)
                self._doubt(*likely[0])
        size, since_s = (track.long, track.wide), seconds - track.missed_s
        lost = Known(track.identity, track.row, track.certainty, size, track.last, since_s)
        if may_return:
            self._lost.append(lost)
        else:
            self._drop([lost])

    def shift(self, x: float, y: float) -> None:
        """Move what is known of lost cells by x, y [um], with the picture's content."""
        for lost in self._lost:
            assert lost.last is not None
            lost.last = lost.last + np.array((x, y))

    def _part(self, meeting: Meeting, places: Floats, seconds: float) -> None:
        """Ask which cell is on which track after a meeting, by where the tracks are."""
        tracks, cells = meeting.tracks, meeting.cells
        table = self._table(cells, places, np.full(len(tracks), PLACE))
        known = self._known(meeting, table)
        moves = orders(len(tracks))  # of each track, the number of its cell before
        prior = table[np.arange(len(tracks)), moves].sum(axis=1)
        meeting.cells = []
        self._forget(meeting)
        self._ask(tracks, cells, prior, known, places, seconds)

    def _ask(
        self,
        tracks: Sequence[CellTrack],
        cells: Sequence[Known],
        prior: Floats,
        known: Floats,
        places: Floats,
        since_s: float,
    ) -> None:
        """Open a question about tracks at `places` (K, 3): x, y [um], axis [rad]. The cells' filter
        rows are copied for each track; one far from the track is moved to the track.
        """
        bank, places = self._bank, places.copy()
        heading = bank.mean[[track.filter_row for track in tracks], HEADING]
        places[:, 2] += np.pi * np.round((heading - places[:, 2]) / np.pi)
        rows = np.zeros((len(tracks), len(cells)), int)
        for t, place in enumerate(places):
            rows[t] = [bank.copied(cell.filter_row) for cell in cells]
            values = np.tile(place, (len(cells), 1)), np.tile(FIRST, (len(cells), 1))
            _, distance = bank.update(rows[t], *values)
            backwards = np.cos(bank.mean[rows[t], HEADING] - place[2]) < 0
            for n in np.flatnonzero((distance > FAR) | backwards).tolist():
                moved = bank.moved(int(rows[t, n]), *place.tolist())
                bank.drop(int(rows[t, n]))
                rows[t, n] = moved
        question = WhichIsWhich(tuple(tracks), tuple(cells), rows, prior, known, since_s)
        self._drop(cells)
        self._questions.append(question)
        order, _ = question.best()
        for t, track in enumerate(tracks):
            bank.drop(track.filter_row)
            track.question, track.identity = question, cells[order[t]].name
            track.row = int(rows[t, order[t]])

    def _end(self, question: WhichIsWhich) -> None:
        """Settle a question by its likeliest answer."""
        order, shares = question.best()
        likely = question.probabilities()
        asked = tuple(cell.name for cell in question.cells)
        own = np.arange(len(question.cells))
        for t, track in enumerate(question.tracks):
            cell = question.cells[order[t]]
            track.question, track.row = None, int(question.rows[t, order[t]])
            track.identity = cell.name
            track.long, track.wide = cell.size
            if self._certain(track, float(shares[t]) * cell.certainty):
                weights = likely @ (question.orders[:, t, None] == own)
                self._bank.mix(track.filter_row, question.rows[t], weights)
        kept = {track.row for track in question.tracks}
        for row in question.rows.ravel().tolist():
            if row not in kept:
                self._bank.drop(row)
        self._questions.remove(question)
        self._tell(question.tracks, float(likely.max()), asked)

    def _doubt(self, track: CellTrack, probability: float) -> None:
        """Lower the certainty of a track's name to a share, since it was last together."""
        asked = track.identity
        self._certain(track, track.certainty * probability)
        self._tell([track], probability, (asked,))

    def _certain(self, track: CellTrack, certainty: float) -> bool:
        """Set the certainty of a track's name, or give the track a new name; return the latter."""
        track.certainty, splits = certainty, self._splits and certainty < PASSED_ON
        if splits:
            track.identity, track.certainty = self.number(), 1.0
        return splits

    def _tell(self, tracks: Sequence[CellTrack], probability: float, asked: Sequence[int]) -> None:
        named = tuple((t.number, t.identity, t.certainty, t.together_s) for t in tracks)
        self.answers.append(CellAnswer(named, probability, tuple(asked)))

    def _stay(self, meeting: Meeting) -> Floats:
        """Return the probability (K,) that each of the tracks of a meeting still follows the cell
        that it did before, by where the cells are.
        """
        tracks, cells = meeting.tracks, meeting.cells
        now, _ = self._bank.expected(np.array([track.filter_row for track in tracks]))
        deviations = [MERGED[0] if track.merged else PLACE for track in tracks]
        table = self._table(cells, now, np.array(deviations))
        own = np.diagonal(table)
        known = np.diagonal(self._known(meeting, table))
        if len(tracks) > TOGETHER:  # only exchanges of two cells are counted
            exchanged = np.exp(np.minimum(table + table.T - own[:, None] - own, 50.0))
            return known / (exchanged.sum(axis=1))
        order = orders(len(tracks))
        shares = normalised(table[np.arange(len(tracks)), order].sum(axis=1))
        return known * (shares @ (order == np.arange(len(tracks))))

    def _known(self, meeting: Meeting, table: Floats) -> Floats:
        """Return the probability (K, M) that a cell, rather than something unknown that has joined
        a meeting, is where its log-density is that of `table`.
        """
        if not meeting.met:
            return np.ones(table.shape)
        return 1 / (1 + np.exp(np.minimum(self._unknown() - table, 50.0)))

    def _leave(self, meeting: Meeting, track: CellTrack) -> None:
        """Take a track and its cell out of a meeting."""
        at = meeting.tracks.index(track)
        meeting.tracks.pop(at)
        self._drop([meeting.cells.pop(at)])
        track.meeting = None
        if not meeting.tracks:
            self._forget(meeting)

    def _forget(self, meeting: Meeting) -> None:
        """End a meeting."""
        if meeting in self._meetings:
            self._meetings.remove(meeting)
        self._drop(meeting.cells)
        for track in meeting.tracks:
            track.meeting = None

    def _drop(self, cells: Iterable[Known]) -> None:
        """Free the filter's rows of cells."""
        for cell in cells:
            if cell.row is not None:
                self._bank.drop(cell.row)
                cell.row = None

    def _unknown(self) -> float:
        """Return the log-density [1/um^2] of something unknown that comes out of a blob."""
        return math.log(EITHER / (math.pi * (FROM * self._body_um) ** 2))

    def _table(self, cells: Sequence[Known], places: Floats, deviations: Floats) -> Floats:
        """Return the log-density [1/um^2] of cells at places (K, 3), as (K, M), with further
        standard deviations (K,) of the places [lengths of a cell].
        """
        sd_um = self._body_um * deviations
        return log_densities(self._bank, cells, places, sd_um, self._unknown())
