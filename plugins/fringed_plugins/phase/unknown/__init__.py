"""Shifts that nobody knows, estimated from the frames. Knows no contract."""
