"""The experiment as a YAML spec."""
