"""Tools that know nothing of robots: tables, processes, files, the cache of compiled code."""
