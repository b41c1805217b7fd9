"""Feeds the log viewers with a recorded trial that they can play, or with running trials."""

import queue
from bisect import bisect_right

from tetractl.core.clock import SECOND, Clock
from tetractl.core.commands import Command, Note, Sample
from tetractl.core.trial import Result, Start, Step
from tetractl.log.format.channels import CHANNELS
from tetractl.log.read.raw_log import RawLog
from tetractl.log.write.messages import Messages
from tetractl.replay.player import Playback, Player
from tetractl.serve.foxglove_protocol import PlaybackState, Request
from tetractl.serve.live import Viewers

FRAME_NS = SECOND // 60


class ServedReplay:
    """Sends the messages of a log to `viewers` as the time of `player` passes them.

    After a jump in time the newest message of each topic is sent again. Requests of viewers are
    answered at once and obeyed by the next `follow`.
    """

    def __init__(self, contents: RawLog, player: Player) -> None:
        self._start_ns = contents.run.start_unix_ns
        known = [entry for entry in contents.entries if entry.topic in CHANNELS]
        self._entries = sorted(known, key=lambda entry: entry.log_ns)
        self._times = [entry.log_ns for entry in self._entries]
        self._requests: queue.SimpleQueue[Request] = queue.SimpleQueue()
        self.player = player
        self._jumps: int | None = None  # of the player, when it was last followed
        self._sent = 0  # entries before this one were passed
        self._announced: tuple[Playback, float] | None = None
        span_ns = (self._start_ns + player.start_ns, self._start_ns + player.until_ns)
        name = contents.run.items["name"]
        self.viewers = Viewers(name, span_ns, self._asked)

    def follow(self) -> None:
        """Obey the viewers, and send what has come since the last call."""
        player = self.player
        while not self._requests.empty():
            request = self._requests.get()
            at_ns = None if request.seek_ns is None else request.seek_ns - self._start_ns
            player.command(playing=request.playing, rate=request.rate, at_ns=at_ns)
            self._announced = None
        player.update()
        jumped = player.jumps != self._jumps
        now_ns, self._jumps = self._start_ns + player.now, player.jumps
        passed = bisect_right(self._times, now_ns)
        if jumped:
            newest = {entry.topic: entry for entry in self._entries[:passed]}
            self.viewers.jump(now_ns, newest.values())
        else:
            self.viewers.publish(self._entries[self._sent : passed])
        self._sent = passed
        state = player.state, player.rate
        if (jumped or state != self._announced) and player.state is not Playback.QUIT:
            self._announced = state
            self.viewers.announce(PlaybackState(player.state, now_ns, player.rate, jumped))

    def play(self, wall: Clock) -> None:
        """Follow the player until it quits."""
        while self.player.state is not Playback.QUIT:
            self.follow()
            wall.sleep_until(wall.now() + FRAME_NS)

    def _asked(self, request: Request) -> PlaybackState:
        self._requests.put(request)
        time_ns = self._start_ns + self.player.now if request.seek_ns is None else request.seek_ns
        playback = Playback.PLAYING if request.playing else Playback.PAUSED
        return PlaybackState(playback, time_ns, request.rate, request.seek_ns is not None)


class ServedRun:
    """Sends what a log would hold of one trial after another: an `Observer` of each.

    A simulated trial, which would end before it is seen, is slowed to the pace of `wall`.
    """

    def __init__(self, viewers: Viewers, wall: Clock) -> None:
        self._viewers, self._wall = viewers, wall

    def on_start(self, start: Start) -> None:
        """Send the scene of a new trial; the viewers' time goes to its start."""
        self._messages = Messages(start)
        self._paced = start.plant.simulated
        self._began_ns = self._wall.now()
        self._viewers.jump(start.start_unix_ns, self._messages.start())

    def on_samples(self, samples: list[Sample]) -> None:
        """Send camera frames; while no viewer reads, only the newest, for those that come."""
        for sample in samples if self._viewers.watched else samples[-1:]:
            if self._paced:
                self._wall.sleep_until(self._began_ns + sample.observation.received_ns)
            self._viewers.publish(self._messages.samples([sample]))

    def on_step(self, step: Step) -> None:
        """Send a control step."""
        self._viewers.publish(self._messages.step(step))

    def on_command(self, command: Command) -> None:
        """Send a command."""
        self._viewers.publish([self._messages.command(command)])

    def on_note(self, note: Note) -> None:
        """Send an operator message."""
        self._viewers.publish([self._messages.note(note)])

    def on_stop(self, stop: Command, result: Result) -> None:
        """Send how the trial ended."""
        self._viewers.publish(self._messages.stop(stop, result))
