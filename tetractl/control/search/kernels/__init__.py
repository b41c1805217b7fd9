"""Compiled code of `control`: the searches for plans, and the filters that estimate robots' motion.

Searches are written for speed. Each also exists in plain, readable Python, and tests check that the
two agree. The filters are written with the matrices of their equations, and tests compare each step
with textbook formulas and integrated equations of motion.

A search tries many sequences of signals, called particles. Particles are contiguous in memory:
arrays of signals have shape (L, P), arrays of positions (N, P), for L signals, P particles and N
robots. A kernel, which is a compiled function, loops over the particles of one robot in a way that
the compiler turns into vector instructions: functions such as the sine are polynomials, not calls
to the C library, and a robot's constants are scalars. A search allocates no memory and does not
hold the interpreter's lock. Code that runs once per control step (`filter`) is a plain loop over
robots and times, which avoids NumPy's overhead on small arrays.

A kernel is compiled once for each class of constants of a motion (`tetractl.model.motion`).
Obstacles of every shape run the same code, because they are described by numbers.

The compiled code is stored together with a hash of the files and constants that it uses
(`tools.kernels.sources`), so that no outdated code runs after an edit or an upgrade.
"""
