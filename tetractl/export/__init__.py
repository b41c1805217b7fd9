"""Export: logs as tidy tables that other programs read, CSV and Parquet."""
