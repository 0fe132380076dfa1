"""The devices' drivers: each builds on bytes (protocols, transports) or, simulated, on the simulation."""
