"""The command line: one module for each command, which parses, calls and prints.

What is imported here is little, so that `main` soon decides what a signal does.
"""

import sys

from tetractl.cli.streams import open_streams
from tetractl.core.errors import Exit
from tetractl.run.interrupt import leave_on_signals


def main() -> None:
    """Run the command line and exit with one of the codes of `Exit`."""
    messages = open_streams()

    def say() -> None:
        messages.writer.urge(b"error: interrupted\n")
        messages.writer.finish()

    leave_on_signals(Exit.INTERRUPTED, say)
    from tetractl.cli.app import run_app

    code = run_app()
    leave_on_signals(code)
    sys.exit(code)
