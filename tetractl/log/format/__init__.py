"""The format of a trial's log: channels, messages, metadata and digest."""
