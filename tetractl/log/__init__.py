"""The MCAP log of a trial: its format, writing it, reading it, and its provenance."""
