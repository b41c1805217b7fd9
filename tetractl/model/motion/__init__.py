"""Models of how a robot moves under the common direction. `core.registries` lists their files."""
