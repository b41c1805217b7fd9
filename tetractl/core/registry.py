"""Registries of kinds, the objects of tetractl and other packages that a spec names by `type`."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.metadata import EntryPoint, PackageNotFoundError, distribution, entry_points
from importlib.util import find_spec
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from tetractl.core.errors import UsageError


class PluginError(UsageError):
    """A kind that another package provides, such as a camera, cannot be used."""


@dataclass(frozen=True, slots=True)
class Kind:
    """An entry of a registry, such as one of the optimisers.

    Attributes:
        name: The name by which a spec chooses the kind.
        code: Where the kind's object is defined, as "module:attribute".
        package: The package that provides the kind. Empty for a built-in kind.
        version: The version of that package. Empty for a built-in kind.
    """

    name: str
    code: str
    package: str = ""
    version: str = ""

    def __str__(self) -> str:
        return f"{self.name} (from {self.package} {self.version})" if self.package else self.name


class Registry:
    """The kinds of one interface by name, such as all optimisers.

    Other packages can add kinds as entry points. Built-in names take precedence. If two packages
    offer the same name, the first package in alphabetical order is used. A module is imported only
    when its kind is loaded.

    Args:
        group: The group of the entry points: "tetractl." and the plural name of the interface. The
            attribute `what` is the singular name, for messages.
        builtin: The "module:attribute" of each built-in kind, by name.
        base: The "module:attribute" of the class from which every kind is derived. Empty if kinds
            are not classes.
    """

    def __init__(self, group: str, builtin: Mapping[str, str], base: str = "") -> None:
        self.group = group
        self.builtin = dict(builtin)
        self.base = base
        self.what = group.removeprefix("tetractl.").removesuffix("s").replace("_", " ")

    def names(self) -> tuple[str, ...]:
        """List the names of all kinds: first the built-in names, then the others by alphabet."""
        return (*self.builtin, *sorted(self._installed.keys() - self.builtin.keys()))

    def kinds(self) -> tuple[Kind, ...]:
        """List all kinds without loading any, the built-in kinds first."""
        return tuple(map(self.kind, self.names()))

    def kind(self, name: str) -> Kind:
        """Return the registry's entry for a name.

        Raises:
            KeyError: If no kind has this name.
        """
        if name in self.builtin:
            return Kind(name, self.builtin[name])
        return Kind(name, self._installed[name].value, *self._packages[name])

    def __contains__(self, name: object) -> bool:
        return name in self.builtin or name in self._installed

    def load(self, name: str) -> Any:
        """Import and return the object that is registered under this name.

        Raises:
            KeyError: If there is no such name.
            PluginError: If another package offers the kind, but its object cannot be imported or is
                not derived from `base`.
        """
        if name in self.builtin:
            return _builtin(self.builtin[name])
        entry_point = self._installed[name]
        try:
            loaded = entry_point.load()
        except Exception as error:  # a module of another package may raise anything
            message = str(error).partition("\n")[0]
            raise self.create_unusable_error(name, f"{type(error).__name__}: {message}") from error
        if self.base and not (
            isinstance(loaded, type) and issubclass(loaded, resolve_name(self.base))
        ):
            raise self.create_unusable_error(name, f"the object is not a subclass of {self.base}")
        return loaded

    def load_usable(self) -> dict[str, Any]:
        """Load the objects of all kinds that can be used, and return {name: object}.

        Kinds of other packages that cannot be loaded (PluginError) are left out.
        """
        objects: dict[str, Any] = {}
        for name in self.names():
            with suppress(PluginError):
                objects[name] = self.load(name)
        return objects

    def create_unusable_error(self, name: str, reason: str) -> PluginError:
        """Create the error which says that the object of another package cannot be used.

        Args:
            name: The name of the kind.
            reason: The reason, as the end of a sentence.
        """
        entry_point = self._installed[name]
        package, version = _package(entry_point)
        declaration = f"{entry_point.name} = {entry_point.value} of {self.group}"
        return PluginError(
            f"{package} {version}: the {self.what} '{entry_point.name}' cannot be used: {reason}",
            f"update or uninstall the package, whose entry point is '{declaration}'",
        )

    @cached_property
    def _installed(self) -> dict[str, EntryPoint]:
        by_precedence = sorted(entry_points(group=self.group), key=_package, reverse=True)
        # if two packages provide the same name, the alphabetically first is used
        return {point.name: point for point in by_precedence}

    @cached_property
    def _packages(self) -> dict[str, tuple[str, str]]:
        """The name and version of the package that provides each installed kind.

        They are read only once, because after a plug-in's error, the loop that stops robots asks
        for them at every step.
        """
        return {name: _package(point) for name, point in self._installed.items()}


_builtin = cache(resolve_name)  # controllers load the motion several times in a control step


def _package(entry_point: EntryPoint) -> tuple[str, str]:
    """Return the name and the version of the package that declares an entry point.

    If the package is unknown, they are "unknown" and "".
    """
    return (
        (entry_point.dist.name, entry_point.dist.version) if entry_point.dist else ("unknown", "")
    )


def find_package_files(package: str) -> Iterator[Path]:
    """Yield the Python files of a package that extends tetractl, without importing anything.

    Yields nothing if the package is not installed, or declares no entry points of tetractl.
    """
    modules = list[str]()
    with suppress(PackageNotFoundError):
        declared_points = distribution(package).entry_points
        modules += [
            point.module for point in declared_points if point.group.startswith("tetractl.")
        ]
    for top_module in dict.fromkeys(module.partition(".")[0] for module in modules):
        spec = find_spec(top_module)
        if spec is not None and spec.submodule_search_locations:
            for folder in spec.submodule_search_locations:
                yield from Path(folder).rglob("*.py")
        elif spec is not None and spec.origin is not None and Path(spec.origin).exists():
            yield Path(spec.origin)
