"""The commands of `fringed`: run, check, show, plugins, doctor, keys."""
