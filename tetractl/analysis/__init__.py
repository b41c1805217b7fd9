"""Predicts from a spec, without trials, how accurately its robots can be steered under an assumed
noise."""
