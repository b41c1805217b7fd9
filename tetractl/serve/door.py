"""Who is let in by the servers on the loopback address: by token, `Host` and `Origin`.

The token keeps other users of this machine out, for they can reach the port but do not know the
link. A foreign `Host` is another site's name pointed at this machine (DNS rebinding); a foreign
`Origin` is a page of another site in the operator's browser, which a WebSocket does not keep out.
"""

import hmac
import secrets
from urllib.parse import urlsplit

ADDRESS = "127.0.0.1"
TOKEN_BYTES = 12  # so that a link fits beside the arena on a terminal of 80 columns
FOXGLOVE = "https://app.foxglove.dev"
"""Foxglove in the browser."""


def new_token() -> str:
    """Return 96 random bits as text for an address."""
    return secrets.token_urlsafe(TOKEN_BYTES)


def is_token(given: str, token: str) -> bool:
    """Whether a token is the right one; takes as long for any of its length."""
    return hmac.compare_digest(given.encode(), token.encode())


def is_own_host(host: str | None, port: int) -> bool:
    """Whether a request's `Host` names the server at `port` of this machine."""
    return host in (f"{ADDRESS}:{port}", f"localhost:{port}")


def is_viewers_origin(origin: str | None, viewer: str = "") -> bool:
    """Whether a request comes from a program, a desktop viewer or the page of a known viewer.

    Known are Foxglove's, any page served by this machine, and the viewer at the address `viewer`.
    """
    if origin is None or origin in (FOXGLOVE, "file://"):
        return True
    where = urlsplit(origin)
    if where.scheme in ("http", "https") and where.hostname in (ADDRESS, "localhost"):
        return True
    return bool(where.netloc) and where[:2] == urlsplit(viewer)[:2]
