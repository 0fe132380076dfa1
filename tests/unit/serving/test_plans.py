"""What a request for a scan means, and every way in which it cannot be meant."""

import pytest

from fringed.config import simulated_station
from fringed.errors import ConfigurationError, NotFound, UsageError
from fringed.messages import StageCall
from fringed.serving.plans import ScanWish, plan_process, plan_scan

CONFIG = simulated_station()


def test_nothing_asked_for_is_the_default_pipeline():
    plan = plan_scan(CONFIG, ScanWish())
    assert plan.pipeline == "hierarchical"
    assert plan.encoder == StageCall(
        "patterns", "encoder", "multi-frequency", {"periods": [1, 8, 64], "steps": 4, "dither": "quiet"}
    )
    assert [(stage.name, stage.plugin) for stage in plan.stages] == [
        ("phase", "multi-frequency"), ("range", "triangulate")
    ]  # fmt: skip
    assert plan.to_take == ("object",)
    assert plan.cameras["object"].channel == "green"


def test_request_goes_over_preset_goes_over_configuration():
    plan = plan_scan(CONFIG, ScanWish(preset="skin", encoder_params={"steps": 6}, camera={"exposure_us": 4000}))
    assert (plan.cameras["object"].channel, plan.cameras["object"].exposure_us) == ("red", 4000)
    assert plan.encoder.params == {"periods": [1, 8, 64], "steps": 6, "dither": "quiet"}


def test_stage_parameters_are_merged_into_their_stage():
    plan = plan_scan(CONFIG, ScanWish(stages={"range": {"max_sigma_mm": 0.5}}))
    assert plan.stages[1].params == {"max_sigma_mm": 0.5}
    assert plan.stages[0].params == {}


def test_given_frame_sets_are_not_taken():
    plan = plan_scan(CONFIG, ScanWish(pipeline="thesis", frame_sets={"reference": "some-id"}))
    assert plan.roles == ("reference", "object")
    assert plan.to_take == ("object",)


def test_part_of_the_sets_may_be_taken_where_nothing_is_processed_or_the_rest_is_given():
    assert plan_scan(CONFIG, ScanWish(pipeline="thesis", roles=["reference"], process=False)).to_take == ("reference",)
    wish = ScanWish(pipeline="thesis", roles=["object"], frame_sets={"reference": "some-id"})
    assert plan_scan(CONFIG, wish).to_take == ("object",)


@pytest.mark.parametrize(
    ("wish", "error", "text"),
    [
        (ScanWish(pipeline="nonsense"), NotFound, "there are .*hierarchical.*thesis"),
        (ScanWish(preset="nonsense"), NotFound, "there are plaster, skin"),
        (ScanWish(preset="skin", pipeline="thesis"), UsageError, "give only one"),
        (ScanWish(roles=["reference"]), UsageError, "has no role 'reference'; its roles: object"),
        (ScanWish(pipeline="thesis", roles=["reference"]), UsageError, "needs the set object.*process=false"),
        (ScanWish(roles=[]), UsageError, "at least one"),
        (ScanWish(frame_sets={"dark": "id"}), UsageError, "its roles: object"),
        (ScanWish(roles=["object", "object"]), UsageError, "each once"),
        (ScanWish(stages={"nonsense": {}}), UsageError, "has the stages phase, range"),
        (ScanWish(stages={"phase": 3}), UsageError, "each takes a table"),
        (ScanWish(camera={"exposure": 1}), ConfigurationError, "camera.exposure"),
        (ScanWish(camera={"exposure_us": -1, "channel": "pink"}), ConfigurationError, "2 problems"),
    ],
)
def test_what_cannot_be_meant_says_what_can(wish, error, text):
    with pytest.raises(error, match=text):
        plan_scan(CONFIG, wish)


def test_stages_of_a_request_are_read_as_tables_with_sensible_defaults():
    plan = plan_process(CONFIG, "", [{"plugin": "icp"}, {"name": "file", "kind": "exporter", "plugin": "ply"}], {})
    assert [(s.name, s.kind, s.plugin) for s in plan.stages] == [
        ("icp", "processor", "icp"),
        ("file", "exporter", "ply"),
    ]


WRONG_STAGES = [
    [], [{}], ["x"],
    [{"plugin": "a", "kind": "nonsense"}], [{"plugin": "a", "typo": 1}], [{"plugin": "a"}, {"plugin": "a"}],
]  # fmt: skip


@pytest.mark.parametrize("stages", WRONG_STAGES)
def test_stages_that_cannot_be_meant_are_refused(stages):
    with pytest.raises(UsageError, match="stage"):
        plan_process(CONFIG, "", stages, {})


BRACKETED = simulated_station(
    {
        "pipelines": {
            "bracket": {
                "encoder": "multi-frequency",
                "roles": ["object", "object-short"],
                "camera": {"channel": "red", "exposure_us": 8000},
                "role_camera": {"object-short": {"exposure_factor": 0.25}},
                "stages": [{"processor": "multi-frequency", "inputs": {"frames": "object"}}],
            }
        },
        "presets": {"bright": {"pipeline": "bracket", "role_camera": {"object-short": {"exposure_factor": 0.1}}}},
    }
)


def exposures(**wish):
    cameras = plan_scan(BRACKETED, ScanWish(**{"pipeline": "bracket", **wish})).cameras
    return {role: (settings.channel, round(settings.exposure_us, 3)) for role, settings in cameras.items()}


def test_a_role_has_camera_settings_of_its_own_over_those_of_the_scan():
    assert exposures() == {"object": ("red", 8000), "object-short": ("red", 2000)}
    assert exposures(camera={"exposure_us": 4000}) == {"object": ("red", 4000), "object-short": ("red", 1000)}
    assert exposures(pipeline="", preset="bright") == {"object": ("red", 8000), "object-short": ("red", 800)}
    asked = {"object-short": {"exposure_us": 500}}
    assert exposures(role_camera=asked)["object-short"] == ("red", 500)
    assert exposures(roles=["object"]) == {"object": ("red", 8000)}


@pytest.mark.parametrize(
    ("wish", "error", "text"),
    [
        ({"nonsense": {}}, UsageError, "the roles are object, object-short"),
        ({"object-short": {"exposure_factor": 0}}, ConfigurationError, "exposure_factor"),
        ({"object-short": {"exposure_factor": "half"}}, ConfigurationError, "exposure_factor"),
        ({"object-short": {"exposure": 3}}, ConfigurationError, r"role_camera\.object-short\.exposure"),
        ({"object-short": 3}, ConfigurationError, "a table"),
        ({"object-short": {"exposure_factor": 1e9}}, ConfigurationError, "exposure_us"),
    ],
)
def test_camera_settings_of_a_role_that_cannot_be_meant_say_what_can(wish, error, text):
    with pytest.raises(error, match=text):
        exposures(role_camera=wish)


def test_configured_camera_tables_are_checked_when_they_are_read():
    over = {
        "pipelines": {
            "hierarchical": {
                "camera": {"exposure": 1, "channel": "pink"},
                "role_camera": {"nobody": {}, "object": {"exposure_factor": -1, "bits": 9}},
            }
        },
        "presets": {"skin": {"camera": {"exposure_factor": 2}, "role_camera": {"reference": {}}}},
    }
    with pytest.raises(ConfigurationError) as caught:
        simulated_station(over)
    told = {problem.path for problem in caught.value.problems}
    assert told == {
        "pipelines.hierarchical.camera.exposure", "pipelines.hierarchical.camera.channel",
        "pipelines.hierarchical.role_camera.nobody", "pipelines.hierarchical.role_camera.object.exposure_factor",
        "pipelines.hierarchical.role_camera.object.bits",
        "presets.skin.camera.exposure_factor", "presets.skin.role_camera.reference",
    }  # fmt: skip
