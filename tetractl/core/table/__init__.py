"""Tables, and all code that writes them: for readers (terminal_table) and as data (table_files,
data).
"""
