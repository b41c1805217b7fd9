"""The command line: one module for each command, which parses, calls and prints."""


def main() -> None:
    """Run the command line and exit with one of the codes of `Exit`.

    Nothing is imported before signals are seen to: Python's own answer to Ctrl-C in the middle of
    an import is a traceback.
    """
    import signal

    signal.signal(signal.SIGINT, signal.SIG_DFL)  # ends the process without a word

    import atexit
    import sys

    from tetractl.cli.streams import open_streams, settle
    from tetractl.core.errors import Exit
    from tetractl.run.interrupt import ignore_signals, leave_on_signals

    atexit.register(ignore_signals)
    messages = open_streams()

    def say() -> None:
        messages.writer.urge(b"error: interrupted\n")
        messages.writer.finish()

    leave_on_signals(Exit.INTERRUPTED, say)
    from tetractl.cli.app import run_app

    code = run_app()
    leave_on_signals(code)
    settle()
    sys.exit(code)
