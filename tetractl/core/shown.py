"""Objects that a notebook displays, through the method that every notebook front end calls."""

from pkgutil import resolve_name


class Shown:
    """A result that a notebook shows as tables and pictures, made by `tetractl.view.notebook`.

    The module is named by a string, so that `core` imports no package above it.
    """

    __slots__ = ()

    def _repr_html_(self) -> str:
        return resolve_name("tetractl.view.notebook:html")(self)
