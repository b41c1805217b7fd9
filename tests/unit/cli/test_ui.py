"""How options of commands are declared."""

from typing import Annotated

from tetractl.cli.ui import declare_options


def command(quiet: Annotated[bool, "--quiet", "-q"] = False) -> int:
    """Do nothing.

    Options:
      quiet: Say nothing.
    """
    return int(quiet)


def test_options_are_declared_without_docstrings(monkeypatch):
    """Regression: `python -OO` keeps no docstrings, and lost -q."""
    monkeypatch.setattr(command, "__doc__", None)
    assert declare_options(command) == "Do nothing."
    (declared,) = command.__annotations__["quiet"].__metadata__
    assert "-q" in declared.param_decls
