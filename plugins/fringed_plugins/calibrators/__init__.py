"""Processors of calibration and verification: parameters and types of the contract; the geometry is in `calibration`."""
