"""Compiled code of `control`: searches and filters.

Searches are written for speed and have a readable twin, and tests check that the two agree. The
filters are written with the matrices of their equations, and tests compare each step with textbook
formulas and integrated equations of motion.

Particles are contiguous in memory: arrays of signals have shape (L, P), arrays of positions (N, P).
A kernel is a loop over the particles of one robot that the compiler turns into vector instructions:
functions such as the sine are polynomials, not calls to the C library, and a robot's constants are
scalars. A search allocates no memory and does not hold the interpreter's lock. Code that runs once
per control step (`filter`) is a plain loop over robots and times, to avoid NumPy's overhead on
small arrays.

A kernel is compiled once for each class of constants of a motion (`tetractl.model.motion`).
Obstacles are numbers: every shape runs the same code.

The compiled code of a kernel is kept for the files and constants that it reaches
(`tools.kernels.sources`), so that no outdated code runs after an edit or an upgrade.
"""
