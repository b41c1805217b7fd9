"""m3pi robots: their commands and replies as bytes, without a serial port."""
