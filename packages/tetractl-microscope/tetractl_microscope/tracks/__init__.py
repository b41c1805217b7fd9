"""Tracks of cells by other programs: reads them and estimates speeds and responses to the field."""
