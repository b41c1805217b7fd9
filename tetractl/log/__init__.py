"""The log of a trial, an MCAP file: its format, writing, reading and provenance.

`read.reader.read_trial` reads a log.
"""
