"""Three frames in the colours of one exposure: crosstalk measured and unmixed. Knows no contract."""
