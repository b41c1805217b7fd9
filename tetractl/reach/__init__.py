"""Analyse whether one common signal can steer the robots of a spec to different places."""
