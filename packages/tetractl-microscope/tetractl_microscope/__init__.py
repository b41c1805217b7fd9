"""Tracks and steers cells under a microscope: cameras that search images, coils, and surveys."""
