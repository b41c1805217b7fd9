"""General tools that are independent of robots: tables, processes, files, and compiled code."""
