"""Predicts the errors of a spec's robots under an assumed noise, without running trials."""
