"""The demonstration: two objects, three views each, measured against the simulator's truth."""
