"""What the tests of the core and of the packages share, and benchmarks use.

`testkit.emulator` and `testkit.microscope` need those packages; the other modules need only the
core. `testkit.references` has slow implementations, written from the equations, to compare with.
"""
