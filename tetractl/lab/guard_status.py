"""The guard's state, and the reason of an abort, which several threads may give."""

import threading

from tetractl.lab.guard_records import GuardState


class GuardStatus:
    """The guard's `state`, after an abort its `reason`, and whether all robots are stopped
    for good, by the operator or as plain stops did not hold them: an `emergency`.

    An abort is final, also if another thread enters a state at the same moment.
    """

    def __init__(self) -> None:
        self.state = GuardState.PREFLIGHT
        self.reason = ""
        self.emergency = False
        self._lock = threading.Lock()

    def enter(self, state: GuardState) -> None:
        """Enter a state, but not after an abort."""
        with self._lock:
            if self.state is not GuardState.ABORT:
                self.state = state

    def abort(self, reason: str, emergency: bool) -> bool:
        """Enter `abort` for a reason; return False if that has happened before."""
        with self._lock:
            self.emergency |= emergency
            if self.state is GuardState.ABORT:
                return False
            self.reason = reason
            self.state = GuardState.ABORT
            return True
