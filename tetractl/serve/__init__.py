"""A live WebSocket for the log viewers Foxglove and Lichtblick."""
