"""Tables of values: `terminal_table` formats them for people, and `table_files` for programs."""
