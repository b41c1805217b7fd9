"""The emulated sides: a tracker and robots at the other end of the topics."""
