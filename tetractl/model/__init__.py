"""Models of robots' motion, of obstacles, and of swimming cells."""
