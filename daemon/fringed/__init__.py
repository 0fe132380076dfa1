"""The lab station for digital fringe projection profilometry: daemon and shared contract."""

__version__ = "0.1.0"
