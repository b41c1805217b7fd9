"""The sections of an experiment's spec, and the code that reads and checks a spec in YAML."""
