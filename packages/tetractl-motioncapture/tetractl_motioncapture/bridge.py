"""The process of libmotioncapture. It prints a line of JSON per frame, and imports little."""

import ctypes
import json
import os
import signal
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TextIO

from tetractl.core.clock import host_ns

DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG of Linux


def stream(connect: Callable[[str, dict[str, str]], Any], name: str, out: TextIO) -> None:
    """Print each frame of a motion-capture system until no program reads it.

    Each frame follows its time on the system's monotonic clock [ns].

    Args:
        connect: Connects to a system, given its name and options.
        name: The system, its hostname and its options, as JSON.
        out: Where to print.
    """
    system, hostname, options = json.loads(name)
    capture = connect(system, {"hostname": hostname, **options})
    with suppress(BrokenPipeError):
        while True:
            capture.waitForNextFrame()
            bodies = {key: _numbers(body) for key, body in capture.rigidBodies.items()}
            if bodies or system != "vrpn":  # of which every other turn has no news
                print(host_ns(), json.dumps({"bodies": bodies}), file=out, flush=True)


def _numbers(body: Any) -> list[float]:
    """Return position [m] and quaternion x, y, z, w of a body."""
    turn = body.rotation
    return [*map(float, body.position), turn.x, turn.y, turn.z, turn.w]


def main() -> None:
    """Stream the system named by the first argument, as long as the parent lives."""
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # libraries print to the standard output what is no frame
    import motioncapture

    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(DIE_WITH_PARENT, signal.SIGKILL)
    try:
        stream(motioncapture.connect, sys.argv[1], out)
    except RuntimeError as error:
        sys.exit(f"motion capture: {error}")


if __name__ == "__main__":
    main()
