"""Control: what estimates, what searches, and the methods that use both."""
