"""Cameras that find robots in pictures: sources of pictures, and the camera that searches them."""
