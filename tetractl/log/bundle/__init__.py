"""Bundles of logs, captures and texts for a report, without names and addresses."""
