"""Bytes to and from a device: serial ports, TCP, USB bulk, loopback. Knows nothing of what the bytes mean."""
