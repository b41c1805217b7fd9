"""The lock of an open file, which ends with the process that holds it."""

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None


def lock_file(descriptor: int) -> None:
    """Lock an open file; BlockingIOError if another process has. Does nothing on Windows, where
    two runs must not be given one folder."""
    if fcntl is not None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
