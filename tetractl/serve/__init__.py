"""A live stream of running trials over a WebSocket, for the log viewers Foxglove and Lichtblick."""
