"""Emulated cameras that send images, and the emulated coil driver.

They need the package tetractl-microscope.
"""
