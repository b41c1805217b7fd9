"""Tables; `terminal_table` writes them for readers, `table_files` as data."""
