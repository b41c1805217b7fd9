"""Models of robots' motion, obstacles and swimming cells."""
