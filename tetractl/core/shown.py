"""What shows itself in a notebook, by the method that every front end asks for."""

from pkgutil import resolve_name


class Shown:
    """A result that a notebook shows as tables and pictures, made by `tetractl.view.notebook`.

    A text names that module, so that `core` imports no package above it.
    """

    __slots__ = ()

    def _repr_html_(self) -> str:
        return resolve_name("tetractl.view.notebook:html")(self)
