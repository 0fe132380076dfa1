"""Devices in software, as processes of their own: they answer a device's bytes at its pace."""
