"""Camera settings of a scan and of one role on the command line, and who is asked to change the object."""

from __future__ import annotations

from fringed_client.cli.scanning import _asked, _by_sight

NOTHING = {"pipeline": None, "preset": None, "roles": None, "used": {}, "stages": {}, "encoder": {}, "truth": False}


def test_camera_settings_with_a_role_are_that_roles_own():
    camera = {"exposure_us": 4000, "object-short.exposure_us": 500, "object-short.gain_db": 3}
    asked = _asked({**NOTHING, "camera": camera})
    assert asked["camera"] == {"exposure_us": 4000}
    assert asked["role_camera"] == {"object-short": {"exposure_us": 500, "gain_db": 3}}
    asked = _asked({**NOTHING, "camera": {}})
    assert asked["camera"] is None and asked["role_camera"] is None


def test_roles_of_one_thing_are_taken_without_a_question_between_them():
    settings = {"object-short": {}, "object-long": {}}
    assert _by_sight(["object-short", "object", "object-long"], settings) == [["object-short", "object", "object-long"]]
    assert _by_sight(["reference", "object", "object-long"], settings) == [["reference"], ["object", "object-long"]]
    assert _by_sight(["board-1", "board-2"], {}) == [["board-1"], ["board-2"]]
