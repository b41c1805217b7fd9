"""m3pi robots: an actuator over an XBee, with two protocols."""
