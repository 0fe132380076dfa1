"""A broken plug-in is listed with its error and harms nobody."""

from __future__ import annotations

import textwrap
from pathlib import Path

import pytest

from fringed.errors import NotFound
from fringed.loading import Catalogue, load_plugins
from fringed.messages import PluginInfo

NO_GROUP = "fringed.tests.no-such-group"
SCENE = """
    from fringed.hookspecs import Params, hookimpl

    class Ball:
        name, version, summary, Params = "{name}", "1", "a ball", Params

        def make(self, params):
            return None

    @hookimpl
    def register_scenes():
        return [Ball]
"""


def load(folder: Path, **files: str) -> tuple[Catalogue, dict[str, PluginInfo]]:
    folder.mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / f"{name}.py").write_text(textwrap.dedent(text))
    catalogue = load_plugins([folder], NO_GROUP)
    return catalogue, {info.name: info for info in catalogue.plugins}


def test_a_file_in_a_folder_is_a_plug_in(tmp_path: Path) -> None:
    catalogue, infos = load(tmp_path, balls='__version__ = "3.1"\n' + textwrap.dedent(SCENE.format(name="ball")))
    info = infos["balls"]
    assert (info.error, info.version, info.provides) == ("", "3.1", {"scene": ("ball",)})
    assert info.distribution.endswith("balls.py")
    assert catalogue.get("scene", "ball").name == "ball"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("import no_such_module", "no_such_module"),
        ("def broken(:", "SyntaxError"),
        ("raise RuntimeError('on import')", "on import"),
        ("raise SystemExit(3)", "SystemExit"),
        ("FRINGED_API_VERSION = 99", "plug-in API 99; this is 1"),
        ("FRINGED_API_VERSION = 'x'", "invalid literal"),
        ("def register_scenes(): raise ValueError('in the hook')", "in the hook"),
        ("def register_scenes(): return 5", "not iterable"),
        ("def register_scenes(): return [object]", "lacks"),
        (SCENE.format(name="x").replace("def make", "def build"), "lacks make"),
    ],
)
def test_a_broken_one_is_listed_and_the_others_work(tmp_path: Path, text: str, why: str) -> None:
    catalogue, infos = load(tmp_path, a_broken=text, z_fine=SCENE.format(name="fine"))
    assert why in infos["a_broken"].error
    assert infos["a_broken"].provides == {}
    assert infos["z_fine"].error == ""
    assert set(catalogue.provided["scene"]) == {"fine"}


def test_a_name_is_provided_once_and_the_first_one_stays(tmp_path: Path) -> None:
    catalogue, infos = load(tmp_path, a=SCENE.format(name="ball"), b=SCENE.format(name="ball"))
    assert infos["a"].error == ""
    assert "'ball' is already provided" in infos["b"].error
    assert catalogue.get("scene", "ball").__module__.endswith("_a")


def test_what_is_missing_is_named_with_what_exists_and_what_is_broken(tmp_path: Path) -> None:
    catalogue, _ = load(tmp_path, fine=SCENE.format(name="ball"), broken="import no_such_module")
    with pytest.raises(NotFound) as caught:
        catalogue.get("scene", "cube")
    message = str(caught.value)
    assert "no scene is called 'cube'; there are ball; broken is broken:" in message
    assert "no_such_module" in message
    with pytest.raises(NotFound, match="there are none"):
        catalogue.get("exporter", "ply")


def test_a_folder_that_does_not_exist_is_listed(tmp_path: Path) -> None:
    (info,) = load_plugins([tmp_path / "nowhere"], NO_GROUP).plugins
    assert "does not exist" in info.error
