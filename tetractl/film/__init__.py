"""Films of cells, after they were made: tracks, speeds and how each cell answers the field."""
