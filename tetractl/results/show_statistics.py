"""Prints results in a format: one path for every command that prints statistics."""

from tetractl.core.table.data import json_text
from tetractl.core.table.table_files import csv_text
from tetractl.core.table.terminal_table import TEXTS, print_tables
from tetractl.results.contrast import GroupComparison
from tetractl.results.items import as_items, data_table
from tetractl.results.tables import tables


def show(found: GroupComparison, form: str) -> None:
    """Print groups and their comparisons to stdout."""
    if form == "table":
        print_tables(tables(found))
    elif form == "json":
        print(json_text(as_items(found)), flush=True)
    elif form == "csv":
        print(csv_text(data_table(found)), end="")
    else:
        print(TEXTS[form](tables(found)))
