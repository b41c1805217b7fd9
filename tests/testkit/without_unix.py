"""Runs tetractl as on Windows, as far as Linux can: `python without_unix.py COMMAND...`.

The modules, functions and signals of Unix are removed. The commands run one after another until one
fails.
"""

import os
import select
import shlex
import signal
import sys

MODULES = {"fcntl", "termios", "tty", "pty", "resource", "pwd", "grp"}
NAMES = {
    os: ("getuid", "geteuid", "fork", "openpty", "O_NOFOLLOW", "O_CLOEXEC"),
    select: ("poll", "epoll", "POLLERR", "POLLHUP", "POLLNVAL"),
    signal: ("pthread_sigmask", "SIGTSTP", "SIGTTIN", "SIGTTOU", "SIGHUP", "SIGQUIT", "SIGUSR1"),
}


class Hidden:
    """Finds no module of Unix."""

    def find_spec(self, name, path=None, target=None):
        if name in MODULES:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


if __name__ == "__main__":
    for name in MODULES:
        sys.modules.pop(name, None)
    sys.meta_path.insert(0, Hidden())
    for module, names in NAMES.items():
        for name in names:
            if hasattr(module, name):
                delattr(module, name)
    from tetractl.cli import main
    from tetractl.cli.app import run_app

    *earlier, last = [["tetractl", *shlex.split(command)] for command in sys.argv[1:]]
    for sys.argv in earlier:
        code = run_app()
        if code != 0:
            sys.exit(int(code))
    sys.argv = last
    main()
