"""Cameras: one module for each driver, all with the interface of `hookspecs.Camera`."""
