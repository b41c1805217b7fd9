"""The MCAP log of a trial: its format, writing it, reading it (`read.reader.read_trial`), and its
provenance.
"""
