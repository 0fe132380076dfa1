"""Reasons to drop a pixel, one module each. Arrays in, arrays out; knows no contract."""
