"""Control: estimate the robots' motion, search for plans, and decide what to send."""
