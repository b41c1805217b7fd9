"""Infers which cell is which after cells have met, or after a cell left another cell's blob.

A *track* is an object that is tracked from image to image. Its *identity* is the number of the cell
that it most probably shows, and its *certainty* is the probability of that number.

- A *meeting* begins when tracks share a blob (`CellIdentities.note_meeting`), so that they may
  exchange their cells. `meetings` computes the *own probability* of each track: the probability
  that the track still shows its own cell.
- When tracks are separate again (`CellIdentities.end_meetings`), those whose own probability is
  above ASSERTED_PROBABILITY keep their identities. For the other tracks, a *question* is opened:
  each track is predicted by one filter row for each cell that it may show, with the turning rate,
  bias, speed and helix of that cell. The likelihoods of later measurements, above all of the
  response to the field, multiply the probability of each assignment of cells to tracks.
- A question is closed once one assignment is certain, or after a maximum time
  (`CellIdentities.answer_questions`).
- If no later measurement can decide, the certainty of a track is multiplied by a probability once
  and for all, and no question is opened.

Each row of the filter has one owner, which frees it: a track without an open question, a cell of a
meeting, or an open question. In the last case, the track's `row` is one of the question's rows.

K is the number of tracks, M the number of cells. Places are x, y [um] and axis [rad], shape (K, 3).
"""

import math
from collections.abc import Collection, Sequence

import numpy as np

from tetractl.core.poses import Floats
from tetractl_microscope.cells.cell import CellAnswer, TrackIdentity
from tetractl_microscope.cells.cell_tracks import (
    CellTrack,
    IdentityQuestion,
    Meeting,
    compute_log_assignment_probabilities,
    list_assignments,
)
from tetractl_microscope.cells.helix import HEADING, HelixFilter
from tetractl_microscope.cells.meetings import ASSIGNED_TRACKS_MAX, POSITION_SD, Meetings

# Probability that a track shows its own cell, above which no question is opened.
ASSERTED_PROBABILITY = 0.99
# Standard deviations of x, y [um] and axis [rad] of a track's blob when a question is opened.
FIRST_BLOB_SD = (2.0, 2.0, 0.1)
# Squared Mahalanobis distance above which the prediction of a cell is moved to the track's blob.
SQUARED_DISTANCE_MAX = 25.0
UNKNOWN_REMEMBERED_S = 0.5  # time for which a meeting with an unknown object is remembered
# Probability that a track still shows its cell after another object came out of the track's blob,
# if nothing more is known.
SPLIT_PROBABILITY = 0.5


class CellIdentities:
    """Infers which cell is on each track, from the meetings of tracks and the open questions.

    For each image, `note_meeting` is called for each group of tracks that cannot be distinguished,
    then `end_meetings` and `answer_questions` once. After that, new cells get a number, and lost
    tracks are forgotten.

    Args:
        cell_filter: The Kalman filter of all cells.
        body_um: Length of a cell [um].
    """

    def __init__(self, cell_filter: HelixFilter, body_um: float) -> None:
        self._cell_filter = cell_filter
        self._body_um = body_um
        self._last_identity = 0
        self._meetings = Meetings(cell_filter, body_um)
        self._questions: list[IdentityQuestion] = []
        self._answers: list[CellAnswer] = []  # those not returned by `take_answers` yet

    def take_answers(self) -> list[CellAnswer]:
        """Return the identities that were inferred since the last call, and clear the list."""
        answers = self._answers
        self._answers = []
        return answers

    def new_identity(self) -> int:
        """Return a number for a new cell. Each call returns the next number, starting with 1."""
        self._last_identity += 1
        return self._last_identity

    # ---- tracks that meet and separate ----

    def note_meeting(self, tracks: Sequence[CellTrack], seconds: float, with_unknown: bool) -> None:
        """Record that the cells on some tracks meet, and cannot be distinguished.

        The tracks share a blob, or the blob of a single track is too large for one cell.

        Args:
            tracks: The tracks.
            seconds: Time of the image [s].
            with_unknown: Whether an unknown object may be in the blob, too.
        """
        for question in {
            id(track.question): track.question for track in tracks if track.question
        }.values():
            self._close_question(question)
        for track in tracks:
            track.together_s = seconds
        self._meetings.join(tracks, with_unknown)

    def end_meetings(
        self, places: dict[int, Floats], awaiting_tracks: Sequence[CellTrack], seconds: float
    ) -> None:
        """End the meetings of cells whose tracks are separate again.

        Args:
            places: x, y [um] and axis [rad] of the blob of each track, by the track's number.
            awaiting_tracks: Tracks near which a new object was first seen that may prove to be a
                cell. A meeting of such a track lasts UNKNOWN_REMEMBERED_S longer.
            seconds: Time of the image [s].
        """
        for meeting in self._meetings.running:
            must_wait = len(meeting.tracks) == 1 or any(
                track in awaiting_tracks for track in meeting.tracks
            )
            apart_since_s = seconds - (UNKNOWN_REMEMBERED_S if must_wait else 0.0)
            separate_tracks = [
                track
                for track in meeting.tracks
                if track.number in places and track.together_s < apart_since_s
            ]
            if separate_tracks:
                self._release_tracks(meeting, separate_tracks)
                if meeting.tracks and all(track in separate_tracks for track in meeting.tracks):
                    self._resolve_meeting(meeting, places, seconds)

    def _release_tracks(self, meeting: Meeting, separate_tracks: Collection[CellTrack]) -> None:
        """Remove the separate tracks of a meeting that certainly show their own cells.

        A track that is alone in its meeting is always removed. The probabilities are computed
        before any track leaves. As long as an unknown object may be with the tracks that stay, no
        track is certain.
        """
        own_probabilities = self._meetings.own_probabilities(meeting).tolist()
        is_alone = len(meeting.tracks) == 1
        are_some_left = any(track not in separate_tracks for track in meeting.tracks)
        for track, own_probability in zip(meeting.tracks, own_probabilities, strict=True):
            if track not in separate_tracks:
                continue
            if is_alone:
                self._meetings.leave(meeting, track)
                if own_probability < ASSERTED_PROBABILITY:
                    self._reduce_certainty(track, own_probability)
            elif own_probability > ASSERTED_PROBABILITY and not (
                meeting.with_unknown and are_some_left
            ):
                self._meetings.leave(meeting, track)

    def _resolve_meeting(self, meeting: Meeting, places: dict[int, Floats], seconds: float) -> None:
        """End a meeting whose tracks are all separate, and open a question about their identities.

        If there are too many tracks for a question, the certainty of each track is reduced instead.
        """
        tracks = meeting.tracks
        if len(tracks) <= ASSIGNED_TRACKS_MAX:
            self._ask_question(
                meeting, np.array([places[track.number] for track in tracks]), seconds
            )
            return
        own_probabilities = self._meetings.own_probabilities(meeting).tolist()
        self._meetings.end(meeting)
        for track, own_probability in zip(tracks, own_probabilities, strict=True):
            self._reduce_certainty(track, own_probability)

    # ---- cells that appear and are lost ----

    def note_split(
        self, new_track: CellTrack, old_track: CellTrack, since_s: float, may_have_entered: bool
    ) -> int | None:
        """Reduce the certainty of a track when a new track came out of its blob.

        It is uncertain which of the two tracks shows the cell that was tracked.

        Args:
            new_track: The new track.
            old_track: The track from whose blob the new track came.
            since_s: When the new object was first seen [s].
            may_have_entered: Whether the new cell may have entered the image.

        Returns:
            The number of the cell that has divided. None if the new cell has another origin: an
            unknown object may have been in the blob, or the new cell may have entered the image.
        """
        meeting = old_track.meeting
        if meeting is not None and len(meeting.tracks) > 1:
            return None
        if meeting is not None and meeting.with_unknown:
            # the two tracks show the cell and something unknown: the nearer to its copy is the cell
            rows = np.array([old_track.row, new_track.row])
            places, _ = self._cell_filter.predict_bodies(rows)
            log_densities = self._meetings.compute_log_densities(
                meeting, places, np.full(2, POSITION_SD)
            )
            log_own, log_other = log_densities[:, 0].tolist()
            old_track.together_s = since_s
            self._meetings.end(meeting)
            self._reduce_certainty(old_track, 1 / (1 + math.exp(log_other - log_own)))
            return None
        if may_have_entered or old_track.question is not None:
            return None
        mother = old_track.identity
        old_track.together_s = since_s
        self._reduce_certainty(old_track, SPLIT_PROBABILITY)
        return mother

    def forget_track(self, track: CellTrack) -> None:
        """Forget a lost track, and free its filter row.

        If only one track remains in a blob that two tracks have shared, it is uncertain which of
        the two cells the remaining track shows.
        """
        if track.question is not None:
            self._close_question(track.question)
        if track.meeting is not None:
            self._forget_in_meeting(track.meeting, track)
        self._cell_filter.free_row(track.row)

    def _forget_in_meeting(self, meeting: Meeting, track: CellTrack) -> None:
        """Remove a lost track from its meeting.

        If one track remains, and its own cell is not likely enough, the meeting ends and
        the certainty of the remaining track's identity is reduced.
        """
        own_probabilities = self._meetings.own_probabilities(meeting).tolist()
        remaining_tracks = [
            (member, own_probability)
            for member, own_probability in zip(meeting.tracks, own_probabilities, strict=True)
            if member is not track
        ]
        self._meetings.leave(meeting, track)
        if len(remaining_tracks) == 1:
            last_track, own_probability = remaining_tracks[0]
            if own_probability < ASSERTED_PROBABILITY:
                self._meetings.end(meeting)
                self._reduce_certainty(last_track, own_probability)

    # ---- answers ----

    def answer_questions(self, seconds: float) -> None:
        """Set identities to the most probable answers, and close the questions that are decided.

        A question is also closed if it has been open for too long.

        Args:
            seconds: Time of the newest image [s].
        """
        for question in list(self._questions):
            self._apply_best_answer(question)
            if question.is_decided(seconds):
                self._close_question(question)

    def probabilities(self, tracks: Sequence[CellTrack]) -> list[float]:
        """Compute for each track the probability that its identity is right.

        A track that is in no question and no meeting keeps its certainty.
        """
        probability_by_track: dict[int, float] = {}
        for question in self._questions:
            assignment, track_probabilities = question.best_assignment()
            for i, track in enumerate(question.tracks):
                probability_by_track[track.number] = float(
                    track_probabilities[i] * question.members[assignment[i]].certainty
                )
        for meeting in self._meetings.running:
            track_probabilities = self._meetings.own_probabilities(meeting)
            for track, own_probability in zip(
                meeting.tracks, track_probabilities.tolist(), strict=True
            ):
                if track.question is None:
                    probability_by_track[track.number] = track.certainty * own_probability
        return [probability_by_track.get(track.number, track.certainty) for track in tracks]

    def _ask_question(self, meeting: Meeting, places: Floats, seconds: float) -> None:
        """End a meeting of cells, and store the question of which cell is on which track.

        Cells that meet look like a single blob. When they separate, it is unknown at first which
        track belongs to which cell.

        Args:
            meeting: The meeting. It is removed from the open meetings.
            places: x, y [um] and axis [rad] of each track's blob, shape (K, 3).
            seconds: Time of the image [s].
        """
        tracks = meeting.tracks
        log_table = self._meetings.compute_log_densities(
            meeting, places, np.full(len(tracks), POSITION_SD)
        )
        known_probability = self._meetings.known_probabilities(meeting, log_table)
        log_prior = compute_log_assignment_probabilities(list_assignments(len(tracks)), log_table)
        rows = self._create_question_rows(meeting, places)
        question = IdentityQuestion(meeting.members, rows, log_prior, known_probability, seconds)
        self._meetings.end(meeting)
        self._questions.append(question)
        for track in tracks:
            self._cell_filter.free_row(track.row)
            track.question = question
        self._apply_best_answer(question)

    def _create_question_rows(self, meeting: Meeting, places: Floats) -> np.ndarray:
        """Create filter rows (K, K) that follow each track of a meeting as each of its cells.

        The rows start from `places` (K, 3), where the blobs of the tracks are. If the prediction of
        a cell is far from the track, or has the opposite heading, it is moved to the track.
        """
        cell_filter = self._cell_filter
        places = places.copy()
        headings = cell_filter.means[[track.row for track in meeting.tracks], HEADING]
        places[:, 2] += np.pi * np.round((headings - places[:, 2]) / np.pi)
        n_cells = len(meeting.members)
        rows = np.zeros((n_cells, n_cells), int)
        for i, place in enumerate(places):
            rows[i] = [cell_filter.copy_row(row) for row in meeting.rows]
            values = np.tile(place, (n_cells, 1))
            deviations = np.tile(FIRST_BLOB_SD, (n_cells, 1))
            _, squared_distances = cell_filter.update(rows[i], values, deviations)
            is_backwards = np.cos(cell_filter.means[rows[i], HEADING] - place[2]) < 0
            for j in np.flatnonzero(
                (squared_distances > SQUARED_DISTANCE_MAX) | is_backwards
            ).tolist():
                moved_row = cell_filter.copy_row_to(int(rows[i, j]), *place.tolist())
                cell_filter.free_row(int(rows[i, j]))
                rows[i, j] = moved_row
        return rows

    def _apply_best_answer(self, question: IdentityQuestion) -> None:
        """Set the identities and filter rows of a question's tracks to its most probable answer."""
        assignment, _ = question.best_assignment()
        for i, track in enumerate(question.tracks):
            track.identity = question.members[assignment[i]].identity
            track.row = int(question.rows[i, assignment[i]])

    def _close_question(self, question: IdentityQuestion) -> None:
        """Close a question with its most probable answer, and report this answer.

        The certainty of each track's identity becomes the answer's probability times the
        cell's certainty before. Filter rows of other answers become free.
        """
        assignment, track_probabilities = question.best_assignment()
        assignment_probabilities = question.probabilities()
        self._apply_best_answer(question)
        for i, track in enumerate(question.tracks):
            cell = question.members[assignment[i]]
            track.question = None
            track.size = cell.size
            certainty = float(track_probabilities[i]) * cell.certainty
            track.certainty = certainty
        kept_rows = {track.row for track in question.tracks}
        for row in question.rows.ravel().tolist():
            if row not in kept_rows:
                self._cell_filter.free_row(row)
        self._questions.remove(question)
        met_identities = [member.identity for member in question.members]
        self._report_answer(question.tracks, float(assignment_probabilities.max()), met_identities)

    def _reduce_certainty(self, track: CellTrack, probability: float) -> None:
        """Reduce the certainty of a track's identity by a factor, and report the new certainty."""
        old_identity = track.identity
        track.certainty *= probability
        self._report_answer([track], probability, [old_identity])

    def _report_answer(
        self, tracks: Sequence[CellTrack], probability: float, met_identities: Sequence[int]
    ) -> None:
        """Report, through `take_answers`, which cells are on some tracks after a meeting."""
        track_identities = tuple(
            TrackIdentity(track.number, track.identity, track.certainty, track.together_s)
            for track in tracks
        )
        self._answers.append(CellAnswer(track_identities, probability, tuple(met_identities)))
