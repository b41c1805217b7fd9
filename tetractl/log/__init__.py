"""The MCAP log of a trial: records, writer, reader, salvage, provenance."""
