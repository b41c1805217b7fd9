"""Makes text of any origin safe to print."""

import unicodedata


def printable(text: str, length: int | None = None) -> str:
    """Return text for one line of a terminal, cut to `length` characters.

    Control characters (C0, escape and C1), changes of the writing direction, line separators and
    the bytes of a file name that is not UTF-8 are written as escapes.
    """
    shown = text if length is None else text[: length + 1]  # never shorter when escaped
    if not shown.isprintable():
        shown = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in shown)
    if length is not None and len(shown) > length:
        return shown[: length - 3] + "..."
    return shown


def cell(text: str) -> str:
    """Return text for a cell of a table that a spreadsheet may open.

    A spreadsheet evaluates text that begins with =, +, - or @, also as full-width signs and after
    white space; an apostrophe in front prevents that.
    """
    safe = printable(text)
    first = unicodedata.normalize("NFKC", text).lstrip()[:1]
    return f"'{safe}" if text[:1] in ("\t", "\r") or first in ("=", "+", "-", "@") else safe


def unit_of(unit: str) -> str:
    """Return a spec's length unit as written for readers, such as "µm"."""
    return unit.replace("um", "µm")
