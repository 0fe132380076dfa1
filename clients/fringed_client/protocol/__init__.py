"""The client's logic without I/O: requests, replies, subscriptions, and what a scan asks in which order."""
