"""The connection to a real lab: cameras, actuators, the safety guard, and the inner loop."""
