"""Pack logs and network captures for a bug report, without names and addresses of people."""
