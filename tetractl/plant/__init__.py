"""What stands behind the controller: the interface and the simulation."""
