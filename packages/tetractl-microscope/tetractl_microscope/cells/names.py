"""Infers which cell is which after cells have met, or after one came out of another cell's blob.

A *track* is an object that is tracked from image to image. Its *identity* is the number of the cell
that it most probably shows, and its *certainty* is the probability of that number.

- A *meeting* begins when tracks share a blob (`Names.meet`), so that they may exchange their cells.
  `meetings` computes the *share* of each track: the probability that it still has its own cell.
- When tracks are apart again (`Names.part`), those with a share above ASSERTED keep their
  identities. For the others, a *question* is opened: each track is predicted by one filter row for
  each cell that it may be, with the turning rate, bias, speed and helix of that cell. The
  likelihoods of later measurements, above all of the response to the field, multiply the
  probability of each assignment of cells to tracks.
- A question is closed once one assignment is certain, or after a maximum time (`Names.answer`).
- A *doubt* multiplies the certainty of a track by a share that later measurements cannot improve.

Each row of the filter has one owner, which frees it: a track without an open question, a cell of a
meeting, or an open question. In the last case, the track's `row` is one of the question's rows.

K is the number of tracks, M the number of cells. Places are x, y [um] and axis [rad], shape (K, 3).
"""

import math
from collections.abc import Collection, Sequence

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell import CellAnswer, TrackName
from tetractl_microscope.cells.cell_tracks import (
    CellTrack,
    Meeting,
    WhichIsWhich,
    log_of_each,
    orders,
)
from tetractl_microscope.cells.helix import HEADING, HelixFilter
from tetractl_microscope.cells.meetings import ORDERED_MOST, PLACE_SD, Meetings

# probability above which no question is asked
ASSERTED = 0.99
FIRST_SD = (2.0, 2.0, 0.1)  # standard deviations of a track's first blob in a question: um, um, rad
FAR = 25.0  # squared distance, in standard deviations, above which a cell is moved to its track
REMEMBERED_S = 0.5  # time for which a meeting with something unknown is remembered
EITHER_OF_TWO = 0.5  # share of a track whose cell is one of two, of which nothing more is known


class Names:
    """Keeps the identities of all tracks, the meetings of tracks, and the open questions.

    For each image, `meet` is called for each group of tracks that cannot be distinguished, then
    `part` and `answer` once. After that, new cells are numbered, and lost ones are given up.

    Args:
        bank: The filter.
        body_um: Length of a cell [um].
    """

    def __init__(self, bank: HelixFilter, body_um: float) -> None:
        self._bank = bank
        self._body_um = body_um
        self._last_number = 0
        self._meetings = Meetings(bank, body_um)
        self._questions: list[WhichIsWhich] = []
        self._answers: list[CellAnswer] = []  # not taken yet

    def take_answers(self) -> list[CellAnswer]:
        """Return the answers since the last call, and remove them from the list."""
        answers = self._answers
        self._answers = []
        return answers

    def take_number(self) -> int:
        """Return a number for a new cell. Each call returns the next number, starting with 1."""
        self._last_number += 1
        return self._last_number

    # ---- tracks that meet and part ----

    def meet(self, together: Sequence[CellTrack], seconds: float, with_unknown: bool) -> None:
        """Record that tracks cannot be distinguished.

        They share a blob, or the blob of a single track is too large.

        Args:
            together: The tracks.
            seconds: Time of the image [s].
            with_unknown: Whether an unknown object may be with them.
        """
        for question in {id(t.question): t.question for t in together if t.question}.values():
            self._end(question)
        for track in together:
            track.together_s = seconds
        self._meetings.bring(together, with_unknown)

    def part(self, places: dict[int, Floats], awaited: Sequence[CellTrack], seconds: float) -> None:
        """End the meetings of tracks that are apart again.

        Args:
            places: x, y [um] and axis [rad] of each track's blob.
            awaited: Tracks near which something new was first seen that may prove to be a cell.
            seconds: Time of the image [s].
        """
        for meeting in self._meetings.running:
            waits = len(meeting.tracks) == 1 or any(track in awaited for track in meeting.tracks)
            apart_since_s = seconds - (REMEMBERED_S if waits else 0.0)
            apart = [
                track
                for track in meeting.tracks
                if track.number in places and track.together_s < apart_since_s
            ]
            if apart:
                self._let_go(meeting, apart)
                if meeting.tracks and all(track in apart for track in meeting.tracks):
                    self._resolve(meeting, places, seconds)

    def _let_go(self, meeting: Meeting, apart: Collection[CellTrack]) -> None:
        """Let the tracks leave that are apart and surely follow their own cells, or that are alone.

        The shares are those before any has left. Nothing is sure as long as something unknown may
        be with those that stay.
        """
        shares = self._meetings.own_shares(meeting).tolist()
        is_alone = len(meeting.tracks) == 1
        some_stay = any(track not in apart for track in meeting.tracks)
        for track, share in zip(meeting.tracks, shares, strict=True):
            if track not in apart:
                continue
            if is_alone:
                self._meetings.leave(meeting, track)
                if share < ASSERTED:
                    self._doubt(track, share)
            elif share > ASSERTED and not (meeting.with_unknown and some_stay):
                self._meetings.leave(meeting, track)

    def _resolve(self, meeting: Meeting, places: dict[int, Floats], seconds: float) -> None:
        """End a meeting whose tracks are all apart.

        It becomes a question of which cell is on which track. If there are too many tracks, each is
        doubted.
        """
        tracks = meeting.tracks
        if len(tracks) <= ORDERED_MOST:
            self._ask(meeting, np.array([places[track.number] for track in tracks]), seconds)
            return
        shares = self._meetings.own_shares(meeting).tolist()
        self._meetings.end(meeting)
        for track, share in zip(tracks, shares, strict=True):
            self._doubt(track, share)

    # ---- cells that appear and are lost ----

    def come_out(
        self, track: CellTrack, near: CellTrack, since_s: float, entered: bool
    ) -> int | None:
        """Doubt the name of a track when a new track came out of its blob.

        It is uncertain which of the two is the cell that was tracked.

        Args:
            track: The new track.
            near: The track that it came out of.
            since_s: When that happened [s].
            entered: Whether the new cell may have entered the image.

        Returns:
            The number of the cell that has divided. None if none has: an unknown object may have
            been in the blob, or the new cell may have entered the image.
        """
        meeting = near.meeting
        if meeting is not None and len(meeting.tracks) > 1:
            return None
        if meeting is not None and meeting.with_unknown:
            # the two tracks show the cell and something unknown: the nearer to its copy is the cell
            rows = np.array([near.row, track.row])
            places, _ = self._bank.expected(rows)
            log_densities = self._meetings.log_densities(meeting, places, np.full(2, PLACE_SD))
            log_own, log_other = log_densities[:, 0].tolist()
            near.together_s = since_s
            self._meetings.end(meeting)
            self._doubt(near, 1 / (1 + math.exp(log_other - log_own)))
            return None
        if entered or near.question is not None:
            return None
        divided = near.identity
        near.together_s = since_s
        self._doubt(near, EITHER_OF_TWO)
        return divided

    def give_up(self, track: CellTrack) -> None:
        """Forget a track.

        If only one track remains in a blob that two have shared, it is uncertain which of the two
        cells it is.
        """
        if track.question is not None:
            self._end(track.question)
        if track.meeting is not None:
            self._give_up_in(track.meeting, track)
        self._bank.drop(track.row)

    def _give_up_in(self, meeting: Meeting, track: CellTrack) -> None:
        """Remove a track that is given up from its meeting.

        If one track remains, and its own cell is not likely enough, the meeting ends and
        the certainty of that track's identity falls.
        """
        shares = self._meetings.own_shares(meeting).tolist()
        remaining = [
            (member, share)
            for member, share in zip(meeting.tracks, shares, strict=True)
            if member is not track
        ]
        self._meetings.leave(meeting, track)
        if len(remaining) == 1:
            last, share = remaining[0]
            if share < ASSERTED:
                self._meetings.end(meeting)
                self._doubt(last, share)

    # ---- answers ----

    def answer(self, seconds: float) -> None:
        """Name tracks by the most probable answers, and close the questions that are decided.

        A question is also closed if it has been open for too long. `seconds` is the
        present time.
        """
        for question in list(self._questions):
            self._name_by(question)
            if question.ends(seconds):
                self._end(question)

    def probabilities(self, tracks: Sequence[CellTrack]) -> list[float]:
        """Compute for each track the probability that its identity is right.

        A track that is in no question and no meeting keeps its certainty.
        """
        by_number: dict[int, float] = {}
        for question in self._questions:
            order, shares = question.best()
            for t, track in enumerate(question.tracks):
                by_number[track.number] = float(shares[t] * question.members[order[t]].certainty)
        for meeting in self._meetings.running:
            shares = self._meetings.own_shares(meeting)
            for track, share in zip(meeting.tracks, shares.tolist(), strict=True):
                if track.question is None:
                    by_number[track.number] = track.certainty * share
        return [by_number.get(track.number, track.certainty) for track in tracks]

    def _ask(self, meeting: Meeting, places: Floats, seconds: float) -> None:
        """Open the question which cell is on which track after a meeting.

        Args:
            meeting: The meeting, which ends.
            places: x, y [um] and axis [rad] of each track, shape (K, 3).
            seconds: The time [s].
        """
        tracks = meeting.tracks
        table = self._meetings.log_densities(meeting, places, np.full(len(tracks), PLACE_SD))
        not_unknown = self._meetings.not_unknown(meeting, table)
        prior = log_of_each(orders(len(tracks)), table)
        rows = self._rows_of_question(meeting, places)
        question = WhichIsWhich(meeting.members, rows, prior, not_unknown, seconds)
        self._meetings.end(meeting)
        self._questions.append(question)
        for track in tracks:
            self._bank.drop(track.row)
            track.question = question
        self._name_by(question)

    def _rows_of_question(self, meeting: Meeting, places: Floats) -> np.ndarray:
        """Create filter rows (K, K) that follow each track of a meeting as each of its cells.

        They start from `places` (K, 3). A cell that was expected far away, or with the opposite
        heading, is moved to the track.
        """
        bank = self._bank
        places = places.copy()
        heading = bank.mean[[track.row for track in meeting.tracks], HEADING]
        places[:, 2] += np.pi * np.round((heading - places[:, 2]) / np.pi)
        cells = len(meeting.members)
        rows = np.zeros((cells, cells), int)
        for t, place in enumerate(places):
            rows[t] = [bank.copied(row) for row in meeting.rows]
            values = np.tile(place, (cells, 1))
            deviations = np.tile(FIRST_SD, (cells, 1))
            _, distance = bank.update(rows[t], values, deviations)
            backwards = np.cos(bank.mean[rows[t], HEADING] - place[2]) < 0
            for n in np.flatnonzero((distance > FAR) | backwards).tolist():
                moved = bank.moved(int(rows[t, n]), *place.tolist())
                bank.drop(int(rows[t, n]))
                rows[t, n] = moved
        return rows

    def _name_by(self, question: WhichIsWhich) -> None:
        """Set the identities and filter rows of a question's tracks to its most probable answer."""
        order, _ = question.best()
        for t, track in enumerate(question.tracks):
            track.identity = question.members[order[t]].name
            track.row = int(question.rows[t, order[t]])

    def _end(self, question: WhichIsWhich) -> None:
        """Close a question with its most probable answer, and report that answer.

        The certainty of each track's identity becomes the answer's probability times the
        cell's certainty before. Filter rows of other answers become free.
        """
        order, shares = question.best()
        probabilities = question.probabilities()
        self._name_by(question)
        for t, track in enumerate(question.tracks):
            cell = question.members[order[t]]
            track.question = None
            track.size = cell.size
            certainty = float(shares[t]) * cell.certainty
            track.certainty = certainty
        kept_rows = {track.row for track in question.tracks}
        for row in question.rows.ravel().tolist():
            if row not in kept_rows:
                self._bank.drop(row)
        self._questions.remove(question)
        names = [member.name for member in question.members]
        self._tell(question.tracks, float(probabilities.max()), names)

    def _doubt(self, track: CellTrack, fraction: float) -> None:
        """Multiply the certainty of a track's identity by a probability, and report this."""
        name_before = track.identity
        track.certainty *= fraction
        self._tell([track], fraction, [name_before])

    def _tell(self, tracks: Sequence[CellTrack], probability: float, met: Sequence[int]) -> None:
        """Add an answer: the names of tracks after the cells `met` could not be distinguished."""
        named = tuple(
            TrackName(track.number, track.identity, track.certainty, track.together_s)
            for track in tracks
        )
        self._answers.append(CellAnswer(named, probability, tuple(met)))
