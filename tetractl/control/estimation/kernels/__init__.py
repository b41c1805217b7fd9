"""The compiled filters that learn how robots move, and the bank that compares these filters."""
