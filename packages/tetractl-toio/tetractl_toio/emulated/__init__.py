"""The emulated side of toio cubes, for tetractl-emulator."""
