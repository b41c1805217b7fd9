"""The lab: cameras, actuators, guard and inner loop."""
