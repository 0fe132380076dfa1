"""Taking frame sets: a pure sequencer, pure checks, and the one thread that touches the devices."""

from fringed.acquisition.listener import AcquisitionRequest, Listener, SetSink
from fringed.acquisition.rig import Rig, Station
from fringed.acquisition.runner import AcquisitionRunner

__all__ = ["AcquisitionRequest", "AcquisitionRunner", "Listener", "Rig", "SetSink", "Station"]
