"""XBee 802.15.4 modules: API frames, and the connection to a module on a serial port."""
