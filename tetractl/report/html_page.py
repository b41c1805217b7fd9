"""The frame of every HTML page that tetractl writes, which needs no network and no other file.

The frame consists of the style, the scripts and the security policy. The report, the player of
trials and the game use it.
"""

import hashlib
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files

ASSETS = files("tetractl.report") / "assets"
"""Folder of the pages' style, frames and scripts."""
THEME = '<button id="theme" aria-label="Light or dark">◐</button>'
"""The button that changes between a light and a dark page."""
SCRIPT_NESTED = "<\u2028\u2029"
"""Characters that JSON inside an HTML script element must not contain as they are."""


@dataclass(frozen=True, slots=True)
class FramedPage:
    """A complete HTML page, which a notebook shows in a frame of its own.

    The frame is a sandbox, so that no script in a log or a spec can reach the rest of the notebook.

    Attributes:
        page: The whole page as HTML.
        height_px: Height of the frame in a notebook [pixels].
    """

    page: str = field(repr=False)
    height_px: int

    def _repr_html_(self) -> str:
        return (
            f'<iframe sandbox="allow-scripts" srcdoc="{escape(self.page)}" width="100%"'
            f' height="{self.height_px}" style="border: 0"></iframe>'
        )


def asset(name: str) -> str:
    """Return the contents of a file in `assets`: a style, a frame of a page, or a script."""
    return (ASSETS / name).read_text("utf-8")


def script_json(text: str) -> str:
    """Escape a JSON text so that it can be placed inside an HTML script element."""
    for unsafe in SCRIPT_NESTED:
        text = text.replace(unsafe, f"\\u{ord(unsafe):04x}")
    return text


def html_page(title: str, body: str, scripts: Sequence[str]) -> str:
    """Create an HTML page from its body and scripts, with tetractl's style.

    The page's security policy allows only these scripts, and nothing from outside the page.

    Args:
        title: The page's title, as text.
        body: The page's contents, as HTML.
        scripts: Names of the scripts in `assets`, in the order in which they need each other.
    """
    program = f'"use strict";\n{"".join(asset(script) for script in scripts)}'
    digest = hashlib.sha256(program.encode()).digest()
    allowed = b64encode(digest).decode()
    policy = (
        f"default-src 'none'; img-src data:; style-src 'unsafe-inline';"
        f" script-src 'sha256-{allowed}'; base-uri 'none'; form-action 'none'"
    )
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(title)}</title>\n<style>\n{asset('page.css')}</style>\n</head>\n<body>\n"
        f"{body}<script>{program}</script>\n</body>\n</html>\n"
    )
