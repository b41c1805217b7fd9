"""The format of a log: channels, messages, metadata, digest."""
