"""The sections of an experiment's spec, and how a spec is read from YAML and checked."""
