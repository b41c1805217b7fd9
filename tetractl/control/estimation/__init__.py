"""Estimate, during a trial, where the robots are, how each one turns, and how late commands act."""
