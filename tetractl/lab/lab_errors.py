"""The one exception of the lab's wire formats."""


class WireError(ValueError):
    """Bytes that do not follow a wire format, or values that do not fit into one.

    Receivers drop and count; nothing else is ever raised by the parsers of `tetractl.lab`.
    """
