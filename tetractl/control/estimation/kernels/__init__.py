"""The filter and its bank of hypotheses, compiled."""
