"""Rehearsals: days with random faults, checked by an observer that knows the truth."""
