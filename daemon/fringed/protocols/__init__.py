"""Sans-I/O protocols: bytes in, events out, commands to bytes. No port, no clock, no thread."""
