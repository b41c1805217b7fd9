"""Warns of a damaged log before its trial is shown."""

import sys

from tetractl.core.text import printable
from tetractl.log.read.trial_log import TrialLog


def warn_of_damage(log: TrialLog) -> None:
    """Print a damaged log's problems and losses to stderr."""
    if log.damage is None:
        return
    for problem in log.damage.problems:
        print(printable(f"damaged: {log.path}: {problem}"), file=sys.stderr)
    for lost in log.damage.lost:
        print(printable(f"lost: {log.path}: {lost}"), file=sys.stderr)
