"""The store: one HDF5 file for each frame set and product, written aside, synced, renamed.

Public: `Store`, `SetWriter`, `Recorder`. Knows nothing of sockets, devices or plug-ins.
"""

from fringed.recording.recorder import Recorder
from fringed.recording.store import Store
from fringed.recording.writer import SetWriter

__all__ = ["Recorder", "SetWriter", "Store"]
