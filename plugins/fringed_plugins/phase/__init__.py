"""Fringe phase: arrays in, arrays out. Knows no contract, no file and no clock."""
