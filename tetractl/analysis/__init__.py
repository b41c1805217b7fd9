"""What robots and an assumed noise allow, from an experiment alone: nothing is run."""
