"""Rehearsals: randomised test runs with faults, checked by an observer that knows the truth."""
