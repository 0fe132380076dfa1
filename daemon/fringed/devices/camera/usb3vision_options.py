"""What a lab can say of its USB3 Vision camera (`camera.options`), with what nobody has confirmed in one place."""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from fringed.hookspecs import Params


class Usb3VisionOptions(Params, frozen=True, kw_only=True):
    """The options of the driver `usb3vision`. Those marked [A] are assumed: correct them for your camera."""

    serial: Annotated[str, Meta(description="its serial number; empty: the only USB3 Vision camera there is")] = ""
    width_px: Annotated[int, Meta(ge=0, le=65536, description="width of its frames; 0: as it stands")] = 0
    height_px: Annotated[int, Meta(ge=0, le=65536, description="height of its frames; 0: as it stands")] = 0
    trigger_line: Annotated[str, Meta(description="its TriggerSource for trigger 'hardware' [A]")] = "Line0"
    exposure_feature: Annotated[
        str, Meta(description="the feature that is its exposure in us; empty: it is set elsewhere, as behind a bridge")
    ] = "ExposureTime"
    gain_feature: Annotated[str, Meta(description="the feature that is its gain in dB [A: some count otherwise]")] = (
        "Gain"
    )
    time_stamps: Annotated[
        Literal["camera", "arrival"],
        Meta(description="where exposure times come from; arrival: from when the frame came, less readout_ms"),
    ] = "camera"
    stamp_marks: Annotated[
        Literal["exposure-start", "exposure-end"],
        Meta(description="which moment the camera's time stamp is of [A: makers differ]"),
    ] = "exposure-start"
    readout_ms: Annotated[
        float,
        Meta(ge=0, le=10000, description="from an exposure's end to its frame [A]", extra_json_schema={"units": "ms"}),
    ] = 0.0
    full_well_electrons: Annotated[float, Meta(gt=0, description="electrons at the greatest number [R]")] = 13000.0
    read_noise_electrons: Annotated[float, Meta(gt=0, description="electrons of noise in the dark [R]")] = 12.0
    incomplete_frames: Annotated[
        Literal["fail", "pass-over"],
        Meta(description="when running freely; pass-over: wait for the next, which shows a gap in the counters"),
    ] = "fail"
    control_timeout_ms: Annotated[
        int,
        Meta(ge=10, le=10000, description="how long to wait for an answer", extra_json_schema={"units": "ms"}),
    ] = 1000
    transfer_bytes: Annotated[
        int, Meta(ge=1024, le=1 << 24, description="size of one transfer", extra_json_schema={"units": "B"})
    ] = 1 << 20
    backend: Annotated[
        str, Meta(description="module:callable that makes a PyUSB backend; empty: the system's libusb")
    ] = ""
