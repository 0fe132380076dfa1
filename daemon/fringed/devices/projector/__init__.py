"""Projectors: one module for each driver, all with the interface of `hookspecs.Projector`."""
