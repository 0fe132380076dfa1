"""From views of boards to a calibrated rig: estimation, its uncertainty, and what speaks against it."""
