"""Search for the control signals of one plan: its cost, the optimisers, and when they stop.

A signal is the direction in which a uniform field steers all robots for one signal period. A
sequence of signals is a plan.
"""
