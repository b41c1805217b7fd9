"""Learnt policies for tetractl: a Gymnasium environment of a trial, and a controller."""
