"""Processors of calibration and verification: their parameters and types; the geometry is in `calibration`."""
