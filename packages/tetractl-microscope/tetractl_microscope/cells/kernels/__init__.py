"""Compiled kernels of the Kalman filter that tracks swimming cells."""
