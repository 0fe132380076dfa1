"""The station's configuration: schema, validation and built-in pipelines."""

from fringed.config.schema import (
    AcquisitionConfig,
    CameraConfig,
    CheckConfig,
    DeviceConfig,
    PipelineConfig,
    PresetConfig,
    StageConfig,
    StationConfig,
    TcpConfig,
    WorkerConfig,
)
from fringed.config.simulated import FAULTS, SimulationConfig
from fringed.config.validation import (
    check_station,
    describe,
    effective,
    examined,
    load_station,
    merged,
    read_toml,
    simulated_station,
    station_of,
    validate,
)

__all__ = [
    "FAULTS", "AcquisitionConfig", "CameraConfig", "CheckConfig", "DeviceConfig", "PipelineConfig", "PresetConfig",
    "SimulationConfig", "StageConfig", "StationConfig", "TcpConfig", "WorkerConfig", "check_station", "describe",
    "effective", "examined", "load_station", "merged", "read_toml", "simulated_station", "station_of", "validate",
]  # fmt: skip
