"""What a station knows without being told: built-in pipelines, and the rig that runs without a configuration.

`SIMULATED` applies only when no configuration is given at all; a configuration that names no camera has
none.
"""

from __future__ import annotations

from typing import Any

BOARD_PROCESSOR = "detect-board"
"""The processor whose parameter `board` is the station's own, unless a pipeline or a scan gives another one."""

PIPELINES: dict[str, Any] = {
    "pipelines": {
        "hierarchical": {
            "summary": "3 frequencies x 4 steps, absolute phase, range image",
            "encoder": "multi-frequency",
            "encoder_params": {"periods": [1, 8, 64], "steps": 4, "dither": "quiet"},
            "stages": [
                {"processor": "multi-frequency", "name": "phase"},
                {"processor": "triangulate", "name": "range"},
            ],
        },
        "heterodyne": {
            "summary": "3 fine frequencies x 4 steps whose beats number the fringes: every frame is sharp",
            "encoder": "heterodyne",
            "stages": [{"processor": "heterodyne", "name": "phase"}, {"processor": "triangulate", "name": "range"}],
        },
        "number-theoretic": {
            "summary": "fine frequencies only, the best for the projector, 3 steps each: least noise, sharp projector",
            "encoder": "number-theoretic",
            "stages": [
                {"processor": "number-theoretic", "name": "phase"},
                {"processor": "triangulate", "name": "range"},
            ],
        },
        "gray": {
            "summary": "4 steps and a Gray code that numbers the fringes: hard light, large steps and mixed albedos",
            "encoder": "gray-phase-shift",
            "stages": [
                {"processor": "gray-phase-shift", "name": "phase"},
                {"processor": "triangulate", "name": "range"},
            ],
        },
        "fourier": {
            "summary": "one frame of a reference plane, one of the object, which may move: the difference, unwrapped",
            "encoder": "fourier",
            "roles": ["reference", "object"],
            "stages": [
                {"processor": "fourier", "name": "wrapped-reference", "inputs": {"frames": "reference"}},
                {"processor": "fourier", "name": "wrapped-object", "inputs": {"frames": "object"}},
                {
                    "processor": "unwrap-difference",
                    "name": "phase",
                    "inputs": {"reference": "wrapped-reference", "object": "wrapped-object"},
                },
                {"processor": "reference-plane", "name": "range", "inputs": {"phase": "phase"}},
            ],
        },
        "one-shot": {
            "summary": "three frequencies in the colours of one exposure: absolute phase of what moves, 3-CCD camera",
            "encoder": "one-shot-frequencies",
            "camera": {"channel": "rgb"},
            "stages": [
                {"processor": "one-shot-frequencies", "name": "phase"},
                {"processor": "triangulate", "name": "range"},
            ],
        },
        "crosstalk": {
            "summary": "black, red, green, blue and white on a grey surface: the colour crosstalk, for one-shot",
            "encoder": "colour-bars",
            "camera": {"channel": "rgb"},
            "stages": [{"processor": "crosstalk", "name": "crosstalk"}],
        },
        "exposure": {
            "summary": "4 steps with exposures of 1/8, 1 and 8 times: what `fringe exposure` measures",
            "encoder": "phase-shift",
            "encoder_params": {"periods": 32, "steps": 4},
            "roles": ["object-short", "object", "object-long"],
            "role_camera": {"object-short": {"exposure_factor": 0.125}, "object-long": {"exposure_factor": 8.0}},
            "stages": [{"processor": "suggest-exposures", "name": "exposures"}],
        },
        "thesis": {
            "summary": "6 steps on a reference plane and 6 on the object, spatial unwrapping of the difference",
            "encoder": "phase-shift",
            "encoder_params": {"periods": 48, "steps": 6},
            "roles": ["reference", "object"],
            "stages": [
                {"processor": "phase-shift", "name": "wrapped-reference", "inputs": {"frames": "reference"}},
                {"processor": "phase-shift", "name": "wrapped-object", "inputs": {"frames": "object"}},
                {
                    "processor": "unwrap-difference",
                    "name": "phase",
                    "inputs": {"reference": "wrapped-reference", "object": "wrapped-object"},
                },
                {"processor": "reference-plane", "name": "range", "inputs": {"phase": "phase"}},
            ],
        },
        "hdr-levels": {
            "summary": "3 frequencies x 4 steps with all and with a quarter of the light: shiny surfaces, one exposure",
            "encoder": "multi-frequency",
            "encoder_params": {"periods": [1, 8, 64], "steps": 4, "levels": [1.0, 0.25]},
            "stages": [{"processor": "fuse-levels", "name": "phase"}, {"processor": "triangulate", "name": "range"}],
        },
        "board": {
            "summary": "3 frequencies x 4 steps along both directions: one pose of a calibration board",
            "encoder": "multi-frequency",
            "encoder_params": {"periods": [1, 8, 64], "steps": 4, "orientation": "both"},
            "roles": ["board"],
            "stages": [
                {
                    "processor": "multi-frequency",
                    "name": "columns",
                    "params": {"orientation": "columns"},
                    "keep": False,
                },
                {"processor": "multi-frequency", "name": "rows", "params": {"orientation": "rows"}, "keep": False},
                {
                    "processor": BOARD_PROCESSOR,
                    "name": "view",
                    "inputs": {"columns": "columns", "rows": "rows"},
                },
            ],
        },
        "tone": {
            "summary": "a grey ramp on any light surface: the projector's tone curve, added to the calibration",
            "encoder": "grey-ramp",
            "stages": [{"processor": "tone-response", "name": "response"}],
        },
        "tone-check": {
            "summary": "12 steps of one frequency, which hold sets of 3 and 4: what `fringe tone verify` compares",
            "encoder": "phase-shift",
            "encoder_params": {"periods": 64, "steps": 12},
            "stages": [{"processor": "phase-shift", "name": "phase"}],
        },
        "hdr": {
            "summary": "exposures of 1/8, 1 and 8 times, each 3 frequencies x 4 steps: dark and shiny surfaces at once",
            "encoder": "multi-frequency",
            "encoder_params": {"periods": [1, 8, 64], "steps": 4},
            "roles": ["object-short", "object", "object-long"],
            "role_camera": {
                "object-short": {"exposure_factor": 0.125},
                "object-long": {"exposure_factor": 8.0},
            },
            "stages": [
                {
                    "processor": "multi-frequency",
                    "name": "phase-short",
                    "inputs": {"frames": "object-short"},
                    "keep": False,
                },
                {"processor": "multi-frequency", "name": "phase-middle", "inputs": {"frames": "object"}, "keep": False},
                {
                    "processor": "multi-frequency",
                    "name": "phase-long",
                    "inputs": {"frames": "object-long"},
                    "keep": False,
                },
                {"processor": "fuse-exposures", "name": "phase"},
                {"processor": "triangulate", "name": "range"},
            ],
        },
    },
    "presets": {
        "skin": {"pipeline": "hierarchical", "camera": {"channel": "red"}, "summary": "red light: least noisy on skin"},
        "plaster": {
            "pipeline": "hierarchical",
            "camera": {"channel": "green"},
            "summary": "green: most precise on plaster",
        },
    },
}

SIMULATED: dict[str, Any] = {
    "name": "simulated",
    "camera": {"driver": "sim"},
    "projector": {"driver": "sim"},
    "calibration": "simulated",
}
