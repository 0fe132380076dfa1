"""Decoders: thin wrappers that take a FrameSet, call one algorithm of `phase` or `unwrap`, and return a PhaseMap."""
