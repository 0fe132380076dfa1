"""Encoders: thin wrappers that turn parameters into a PatternSequence with the arithmetic of `phase`."""
