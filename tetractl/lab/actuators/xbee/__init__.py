"""XBee radio modules (802.15.4): their API frames, and the connection through a serial port."""
