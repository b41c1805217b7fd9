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


def stream(
    connect: Callable[[str, dict[str, str]], Any], arguments_json: str, output: TextIO
) -> None:
    """Print each frame of a motion-capture system, until the output pipe is closed.

    A line contains the time on the host's monotonic clock [ns], then a JSON object: {"bodies":
    {NAME: [x, y, z, qx, qy, qz, qw]}}, with positions in m.

    Args:
        connect: Connects to a system, given its type and a mapping of options.
        arguments_json: JSON array of the system's type, its hostname and a mapping of further
            options.
        output: Where to print.
    """
    system, hostname, options = json.loads(arguments_json)
    capture = connect(system, {"hostname": hostname, **options})
    with suppress(BrokenPipeError):
        while True:
            capture.waitForNextFrame()
            bodies = {
                body_name: _to_numbers(body) for body_name, body in capture.rigidBodies.items()
            }
            if bodies or system != "vrpn":  # of which every other turn has no news
                print(host_ns(), json.dumps({"bodies": bodies}), file=output, flush=True)


def _to_numbers(body: Any) -> list[float]:
    """Return the position [m] and the quaternion x, y, z, w of a rigid body, 7 numbers."""
    quaternion = body.rotation
    return [*map(float, body.position), quaternion.x, quaternion.y, quaternion.z, quaternion.w]


def main() -> None:
    """Stream frames of the system described by the first argument, until the parent process ends.

    If the connection fails, the process exits with a message on its standard error.
    """
    frames_pipe = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # libraries print to the standard output what is no frame
    import motioncapture

    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(DIE_WITH_PARENT, signal.SIGKILL)
    try:
        stream(motioncapture.connect, sys.argv[1], frames_pipe)
    except RuntimeError as error:
        sys.exit(f"motion capture: {error}")


if __name__ == "__main__":
    main()
