"""Absolute phase from several patterns of each pixel. Arrays in, arrays out; knows no contract."""
