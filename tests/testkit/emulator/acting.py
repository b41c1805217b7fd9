"""Activates faults on a device without a script."""

from types import SimpleNamespace


def act(acting, name, **fields):
    """Let a fault of a kind act from now on; return it."""
    fault = SimpleNamespace(fault=name, **fields)
    acting.add(fault)
    return fault
