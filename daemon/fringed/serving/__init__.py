"""The three sockets and what is said on them: thin over zmq, everything in the reactor's thread."""
