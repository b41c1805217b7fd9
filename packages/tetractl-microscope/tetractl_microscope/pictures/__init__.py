"""Cameras that find robots in images: the sources of the images, and the camera's base class."""
