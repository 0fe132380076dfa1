"""The command line `fringe`."""
