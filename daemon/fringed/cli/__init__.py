"""The commands of `fringed`: run, check, show, plugins, doctor, devices, install-service, keys."""
