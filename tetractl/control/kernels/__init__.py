"""Compiled twins of the readable code in `control`, and nothing that is not checked against it.

Particles are contiguous in memory: an array of signals has shape (L, P), and one lane stands for
one robot of one particle, lane = robot * P + particle. A kernel is a loop over lanes that the
compiler turns into vector instructions, so what it calls is written as polynomials, not as
calls to the C library. Nothing is allocated inside a search, and the interpreter's lock is free.
"""
