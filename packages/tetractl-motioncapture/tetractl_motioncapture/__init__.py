"""Motion capture of many makes as a camera, by the library libmotioncapture."""
