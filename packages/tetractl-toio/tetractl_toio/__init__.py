"""toio Core Cubes for tetractl: robots that read their poses from a printed mat, over Bluetooth."""
