"""The command line of tetractl: one module per command, which reads options and prints results."""

ADDRESSES_NEEDED = 1e9
"""Minimum address space of a process [bytes]; with less, OpenBLAS asks for memory forever."""


def main() -> None:
    """Run the command line and exit with one of the codes of `Exit`.

    Signal handlers are set before anything is imported, because Python answers Ctrl-C during an
    import with a traceback.
    """
    import signal

    signal.signal(signal.SIGINT, signal.SIG_DFL)  # for now, Ctrl-C ends the process silently

    import atexit
    import sys

    from tetractl.cli.unread import close_stdout, open_streams, write_at_once
    from tetractl.core.errors import Exit
    from tetractl.run.interrupt import ignore_signals, leave_on_signals

    atexit.register(ignore_signals)
    open_streams()
    leave_on_signals(Exit.INTERRUPTED, lambda: write_at_once(b"error: interrupted\n"))
    allowed = _address_limit()
    if allowed < ADDRESSES_NEEDED:
        print(
            f"error: the address space is limited to {allowed / 1000000.0:.0f} MB, but "
            "tetractl needs 1000 MB",
            "  hint: remove the limit with: ulimit -v unlimited",
            sep="\n",
            file=sys.stderr,
        )
        sys.exit(Exit.FAILED)
    from tetractl.cli.app import run_app

    code = run_app()
    leave_on_signals(code)
    close_stdout()
    sys.exit(code)


def _address_limit() -> float:
    """Return how much address space the process may use [bytes]."""
    try:
        import resource
    except ImportError:  # Windows does not have this module
        return float("inf")
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    return float("inf") if limit == resource.RLIM_INFINITY else limit
