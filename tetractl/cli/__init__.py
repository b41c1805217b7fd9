"""The command line: one module per command, which reads the options and prints results."""


def main() -> None:
    """Run the command line and exit with one of the codes of `Exit`.

    Signal handlers are set before anything is imported, because Python answers Ctrl-C during an
    import with a traceback.
    """
    import signal

    signal.signal(signal.SIGINT, signal.SIG_DFL)  # for now, Ctrl-C ends the process silently

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
    if (limit := _address_limit()) < 1e9:  # bytes; with fewer, OpenBLAS retries without end
        text = f"error: {limit / 1e6:.0f} MB of address space are allowed, 1000 are needed\n"
        messages.writer.urge(text.encode() + b"  hint: ulimit -v unlimited\n")
        messages.writer.finish()
        sys.exit(Exit.FAILED)
    from tetractl.cli.app import run_app

    code = run_app()
    leave_on_signals(code)
    settle()
    sys.exit(code)


def _address_limit() -> float:
    """Return the largest address space that the process may use [bytes]."""
    try:
        import resource
    except ImportError:  # Windows does not have this module
        return float("inf")
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return float("inf") if limit == resource.RLIM_INFINITY else limit
