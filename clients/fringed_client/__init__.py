"""Clients of a station: Python, command line."""
