"""The display process: one full-screen window on one display, in a process of its own.

SDL wants the main thread, may end its process when the X server goes, and may hang in a graphics driver: none of
that may happen to the daemon. `messages` and `patterns` are what both sides share; the rest runs in the process only.
It sees the contract (`hookspecs` and below), and no device.
"""
