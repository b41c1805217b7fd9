"""An emulated lab on real sockets and ports: a camera and an actuator of the spec's types.

A run connects to addresses and a port name, as in a real lab; every device states that it is
emulated. `emulated_lab.EmulatedLab` connects camera and actuator.
"""
