"""Cells under a microscope: cameras that search pictures, coils, films and surveys."""
