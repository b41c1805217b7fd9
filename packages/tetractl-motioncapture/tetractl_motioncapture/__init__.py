"""Camera for motion-capture systems of several brands, through the library libmotioncapture."""
