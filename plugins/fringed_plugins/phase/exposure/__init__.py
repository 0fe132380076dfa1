"""Several exposures of one scene: which ones, and their phases in one. Knows no contract."""
