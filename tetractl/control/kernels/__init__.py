"""Compiled twins of the readable code in `control`; tests check each against its readable version.

Particles are contiguous in memory: an array of signals has shape (L, P), of positions (N, P). A
kernel is a loop over the particles of one robot that the compiler turns into vector instructions:
its functions are polynomials, not calls to the C library, and quantities of the robot are scalars.
Nothing is allocated inside a search, and the interpreter's lock is free. What is done once per
control step (`identify`, `losses`) is a plain loop over robots and times, which calls what it
needs: it saves the overhead of NumPy on small arrays.

A kernel is compiled once for each class of constants of a motion (`tetractl.model.motion`) and for
each set of kinds of obstacles (`tetractl.model.shapes`).

A kernel depends on the other files here and on those of motions and shapes, so each state of them
gets a cache of its own (`cache`); without that, an edit or an upgrade would go on running old code.
"""
