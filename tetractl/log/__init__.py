"""The MCAP log of a trial.

This package contains its format, writing, reading (`read.reader.read_trial`) and provenance.
"""
