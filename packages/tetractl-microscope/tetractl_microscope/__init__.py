"""Cells under a microscope: cameras that search pictures, coils, surveys and tracks."""
