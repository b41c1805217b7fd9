"""The child process that runs libmotioncapture, and prints each frame as a line of JSON.

It imports few modules, so that it starts quickly.
"""

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
    """Print each frame of a motion-capture system, until the output pipe is closed.

    A line contains the time on the host's monotonic clock [ns], then a JSON object: {"bodies":
    {NAME: [x, y, z, qx, qy, qz, qw]}}, with positions in m.

    Args:
        connect: Connects to a system, given its type and a mapping of options.
        name: JSON array of the system's type, its hostname and a mapping of further options.
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
    """Return the position [m] and the quaternion x, y, z, w of a rigid body, 7 numbers."""
    turn = body.rotation
    return [*map(float, body.position), turn.x, turn.y, turn.z, turn.w]


def main() -> None:
    """Stream frames of the system described by the first argument, until the parent process ends.

    If the connection fails, the process exits with a message on its standard error.
    """
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
