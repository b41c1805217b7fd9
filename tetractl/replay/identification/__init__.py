"""What recorded trials tell of robots and commands, with intervals."""
