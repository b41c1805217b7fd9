"""An emulated lab on real wires: a camera's side and an actuator's side of the spec's types.

A run is given addresses and a port name, as in a real lab; everything here states that it is
an emulation. `lab.EmulatedLab` puts the two sides together.
"""
