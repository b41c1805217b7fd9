"""An emulated lab on real wires: a camera's side and an actuator's side of the spec's types.

What drives it is given addresses and a port name and cannot notice it; everything here says aloud
that it is an emulation. `lab.EmulatedLab` puts the two sides together.
"""
