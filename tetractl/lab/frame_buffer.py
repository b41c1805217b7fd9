"""A buffer of accepted camera frames, shared between the inner loop's thread and its readers."""

import threading
from collections import deque
from itertools import islice

from tetractl.lab.frames import AcceptedFrame
from tetractl.tools.worker import QUEUE_MAX


class FrameBuffer:
    """The most recent camera frames that the guard has accepted.

    The inner loop appends frames, and any thread can read them. A lock protects the buffer.
    """

    def __init__(self) -> None:
        self.newest: AcceptedFrame | None = None
        self.count = 0  # number of frames appended so far
        self._frames: deque[AcceptedFrame] = deque(maxlen=QUEUE_MAX)
        self._lock = threading.Lock()

    def append(self, frame: AcceptedFrame) -> None:
        """Append the next frame, and drop the oldest one if the buffer is full."""
        with self._lock:
            self._frames.append(frame)
            self.newest = frame
            self.count += 1

    def since(self, count: int) -> tuple[list[AcceptedFrame], int]:
        """Return the frames appended after the first `count` frames, oldest first.

        Args:
            count: Number of frames that the caller has read already.

        Returns:
            The frames, without frames that the buffer has dropped, and the number of all frames
            appended so far. Pass this number as `count` to the next call.
        """
        with self._lock:
            new_frames = list(islice(reversed(self._frames), max(self.count - count, 0)))
            new_frames.reverse()
            return new_frames, self.count

    def recent(self, span_ns: int) -> list[AcceptedFrame]:
        """Return the frames exposed at most `span_ns` before the newest frame, oldest first."""
        with self._lock:
            frames: list[AcceptedFrame] = []
            for frame in reversed(self._frames):
                if self._frames[-1].frame.sampled_ns - frame.frame.sampled_ns > span_ns:
                    break
                frames.append(frame)
        return frames[::-1]
