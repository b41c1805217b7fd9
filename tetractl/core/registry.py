"""Kinds by name: what a `type` in a spec stands for, built in or installed with other packages."""

from collections.abc import Iterator, Mapping
from functools import cached_property
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any


class Registry:
    """The kinds of one seam by name, such as the optimisers.

    `builtin` maps a name to "module:attribute". Other packages add their own as entry points of
    `group`; a name that is built in stays built in. A module is imported when its kind is loaded.
    """

    def __init__(self, group: str, what: str, builtin: Mapping[str, str]) -> None:
        self.group, self.what, self.builtin = group, what, dict(builtin)

    def names(self) -> tuple[str, ...]:
        """Return the names that can be loaded, the built-in ones first."""
        return tuple(dict.fromkeys((*self.builtin, *sorted(self._installed))))

    def __contains__(self, name: object) -> bool:
        return name in self.builtin or name in self._installed

    def load(self, name: str) -> Any:
        """Return what a name stands for; KeyError where nothing is called so."""
        if name in self.builtin:
            module, _, attribute = self.builtin[name].partition(":")
            return getattr(import_module(module), attribute)
        return self._installed[name].load()

    def files(self) -> Iterator[Path]:
        """Yield the source file of each kind's module, without importing it."""
        modules = [target.partition(":")[0] for target in self.builtin.values()]
        modules += [point.module for point in self._installed.values()]
        for module in dict.fromkeys(modules):
            spec = find_spec(module)
            if spec is not None and spec.origin is not None and Path(spec.origin).exists():
                yield Path(spec.origin)

    @cached_property
    def _installed(self) -> dict[str, EntryPoint]:
        return {point.name: point for point in entry_points(group=self.group)}
