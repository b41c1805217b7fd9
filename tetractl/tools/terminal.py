"""Detect whether a stream is a terminal at which a person reads and presses keys.

Every part of the program that shows images, sends terminal codes, or waits for a key uses this
module.
"""

import os
import sys
from collections.abc import Mapping
from typing import IO


def is_terminal(stream: IO[str] | None) -> bool:
    """Check whether a stream is a terminal with a person in front of it.

    A command in a cell of a notebook, such as `!tetractl run`, has a pseudo-terminal. However, no
    key reaches it, and its output goes into the notebook's file, so it does not count as a
    terminal.
    """
    return stream is not None and stream.isatty() and not _is_in_notebook(os.environ)


def has_keys() -> bool:
    """Check whether a person can press keys, because stdin is a terminal."""
    return is_terminal(sys.stdin)


def _is_in_notebook(environment: Mapping[str, str]) -> bool:
    """Check whether a Jupyter kernel started this process.

    Jupyter sets JPY_PARENT_PID when it starts a kernel. Kernels that other programs start (such as
    VS Code) are known by the settings that every IPython kernel gives its child processes.
    """
    ipykernel_settings = {"TERM": "xterm-color", "CLICOLOR_FORCE": "1", "GIT_PAGER": "cat"}
    return "JPY_PARENT_PID" in environment or ipykernel_settings.items() <= environment.items()
