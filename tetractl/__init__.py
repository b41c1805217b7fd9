"""tetractl: steer several robots at once with one control signal."""

__version__ = "0.1.0"
