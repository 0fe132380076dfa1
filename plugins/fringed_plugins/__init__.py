"""Built-in plug-ins: they use the same entry points and rules as anybody's."""
