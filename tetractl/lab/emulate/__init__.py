"""An emulated lab on real wires: cameras over UDP, a radio on a pseudo-terminal, robots behind it.

What drives it is given addresses and a port name and cannot tell; everything here says aloud that
it is an emulation. `lab.EmulatedLab` puts the parts together.
"""
