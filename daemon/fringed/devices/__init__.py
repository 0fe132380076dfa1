"""The devices that the daemon's acquisition thread drives, and nobody else."""
