"""Processors of registration: their parameters, types and words; the geometry is in `registration`."""
