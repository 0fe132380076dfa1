"""Phases of a single frame, by Fourier transforms of the whole and of windows. Knows no contract."""
