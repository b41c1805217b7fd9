"""What stands behind the controller: the seam and the simulation."""
