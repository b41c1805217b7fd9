"""An emulated lab on real sockets and ports: a camera and an actuator of the spec's types.

A run connects to network addresses and to a serial port by its name, as in a real lab; every device
states that it is emulated. `emulated_lab.EmulatedLab` connects camera and actuator.
"""
