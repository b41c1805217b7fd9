"""How an emulated device says what it is, in the name it gives when it is connected to."""

EMULATED = "EMULATED by tetractl"


def is_emulated(name: str) -> bool:
    """Return whether a device's name for itself says that it is emulated."""
    return EMULATED in name
