"""m3pi robots: what goes to them and comes back, as bytes, without a serial port."""
