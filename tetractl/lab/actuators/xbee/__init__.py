"""XBee 802.15.4 modules: API frames to values and back, without a serial port."""
