"""Helpers that the tests of the core, the tests of packages, and the benchmarks share.

`testkit.emulator` and `testkit.microscope` need those packages. The other modules need only the
core. `testkit.references` has slow implementations, written from the equations, to compare with.
"""
