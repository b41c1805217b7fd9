"""The base class of results that a notebook displays as tables and figures."""

from pkgutil import resolve_name


class NotebookDisplay:
    """Base class of results that a notebook displays as tables and figures.

    Every notebook calls `_repr_html_`. `tetractl.view.notebook` makes the HTML. That module is
    named by a string, so that `core` imports no package above it.
    """

    __slots__ = ()

    def _repr_html_(self) -> str:
        return resolve_name("tetractl.view.notebook:html")(self)
