"""Geometry of a calibrated rig: arrays in, arrays out. Knows no contract, no file and no clock."""
