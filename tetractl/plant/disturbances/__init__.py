"""The disturbances of a simulated plant. `core.registries` lists their names."""
