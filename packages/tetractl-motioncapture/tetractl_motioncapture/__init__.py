"""Motion capture of many brands as a camera, with the library libmotioncapture."""
