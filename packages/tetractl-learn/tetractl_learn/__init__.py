"""Learnt policies for tetractl: a trial as an environment of Gymnasium, and a controller."""
