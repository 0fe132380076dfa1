"""`fringed` on the command line: settings, check, show, doctor, keys, errors and exit codes."""

import json
import os
import subprocess
import sys
import tomllib

import pytest
from click.testing import CliRunner

from fringed.cli.configuration import configuration, parsed_settings
from fringed.cli.main import cli, main
from fringed.config import StationConfig, effective, simulated_station, validate
from fringed.config import toml_text as toml
from fringed.errors import ConfigurationError, UsageError


def run(capsys, *arguments):
    """Run a command as a program would; return exit code, output, errors."""
    code = 0
    try:
        main(list(arguments))
    except SystemExit as ended:
        code = ended.code
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_settings_are_toml_or_text_and_are_nested():
    assert parsed_settings(["a.b=1", "a.c=x y", "d=[1, 2]", "a.e=true"]) == {
        "a": {"b": 1, "c": "x y", "e": True}, "d": [1, 2]
    }  # fmt: skip


@pytest.mark.parametrize("bad", ["a", "=1", "a..b=1"])
def test_a_setting_that_is_none_is_refused(bad):
    with pytest.raises(UsageError, match="KEY=VALUE"):
        parsed_settings([bad])


def test_without_a_file_the_rig_is_simulated_and_settings_go_over_it():
    config = configuration(None, ["simulation.sensor.width_px=160"])
    assert (config.camera.driver, config.simulation.sensor.width_px) == ("sim", 160)


def test_a_file_gets_no_simulated_rig_by_itself(tmp_path):
    (tmp_path / "a.toml").write_text('name = "lab"')
    assert configuration(tmp_path / "a.toml").camera.driver == "none"


def test_the_effective_configuration_is_read_back_as_the_same():
    config = simulated_station({"presets": {"odd name.x": {"pipeline": "thesis", "summary": 'a "b" \\ ü\n'}}})
    assert validate(tomllib.loads(toml.dumps(effective(config))), StationConfig) == config


def test_show_prints_toml_that_check_accepts(capsys, tmp_path):
    code, out, _ = run(capsys, "show", "--set", "name=mine")
    assert code == 0
    (tmp_path / "mine.toml").write_text(out)
    assert run(capsys, "check", "--no-plugins", str(tmp_path / "mine.toml"))[0] == 0
    assert json.loads(run(capsys, "show", "--json")[1])["name"] == "simulated"


def test_check_lists_every_problem_with_path_value_and_what_is_allowed(capsys, tmp_path):
    (tmp_path / "bad.toml").write_text(
        'naem = "x"\n[camera]\ndriver = "sim"\nexposure_us = -1\nbits = 9\n[projector]\ndriver = "sim"\n'
    )
    code, _, err = run(capsys, "check", str(tmp_path / "bad.toml"))
    assert code == 2
    assert "3 problems" in err
    assert "did you mean 'name'" in err
    assert "camera.exposure_us: -1 is not allowed; expected number > 0" in err
    assert "camera.bits: 9 is not allowed; expected one of 8, 10, 12, 16" in err


def test_check_knows_plug_ins_and_their_parameters(capsys, tmp_path):
    (tmp_path / "bad.toml").write_text(
        '[pipelines.mine]\nencoder = "multi-frequency"\nencoder_params = { stepz = 3 }\n'
        'stages = [{ processor = "nonsense" }, { processor = "triangulate", params = { typo = 1 } }]\n'
        '[presets.p]\npipeline = "mine"\nstages = { range = { a = 1 } }\n'
    )
    code, _, err = run(capsys, "check", str(tmp_path / "bad.toml"))
    assert code == 2
    for path in ("pipelines.mine.encoder_params.stepz", "pipelines.mine.stages[0].processor",
                 "pipelines.mine.stages[1].params.typo", "presets.p.stages.range"):  # fmt: skip
        assert path in err


def test_check_tells_everything_in_one_round(capsys, tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "broken.py").write_text("raise ValueError('no such luck')\n")
    (tmp_path / "bad.toml").write_text(
        f'calibration = "nofile.h5"\ndefault_pipeline = "nothing"\n[camera]\nbits = 9\n'
        f'[simulation.scene]\nobject = "nope"\n[workers]\nplugin_folders = ["{tmp_path}/folder"]\n'
        '[pipelines.mine]\nencoder = "nonsense"\nstages = [{ processor = "triangulate", params = { typo = 1 } }]\n'
        '[presets.p]\npipeline = "nothing"\n'
    )
    code, out, _ = run(capsys, "check", "--json", str(tmp_path / "bad.toml"))
    found = {problem["path"]: problem["allowed"] for problem in json.loads(out)["problems"]}
    assert code == 2
    assert set(found) == {
        "calibration", "default_pipeline", "camera.bits", "simulation.scene.object", "workers.plugin_folders",
        "pipelines.mine.encoder", "pipelines.mine.stages[0].params.typo", "presets.p.pipeline",
    }  # fmt: skip
    assert found["pipelines.mine.encoder"].startswith("one of ")
    assert "no such luck" in found["workers.plugin_folders"]


@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        (("check", "/nowhere/at/all.toml"), 2, "there is no file /nowhere/at/all.toml"),
        (("run", "--set", "nonsense"), 2, "expected KEY=VALUE"),
        (("show", "--set", "workers.count=-3"), 2, "workers.count: -3 is not allowed"),
        (("run", "--set", "simulation.scene.object=nope"), 2, "expected one of plane, sphere, ball-bar, steps"),
        (("nonsense",), 2, "No such command"),
        (("keys", "new", "a/b", "--dir", "/tmp"), 2, "is no name for keys"),
    ],
)
def test_errors_are_one_message_without_a_trace(capsys, arguments, code, text, tmp_path, monkeypatch):
    monkeypatch.setenv("FRINGED_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("FRINGED_DATA_DIR", str(tmp_path / "data"))
    ended, _, err = run(capsys, *arguments)
    assert ended == code
    assert text in err
    assert "Traceback" not in err


def test_doctor_tells_what_it_found_and_what_to_do(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("FRINGED_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("FRINGED_DATA_DIR", str(tmp_path / "data"))
    code, out, _ = run(capsys, "doctor", "--json")
    found = {item["what"]: item for item in json.loads(out)}
    assert code == (1 if any(item["level"] == "fail" for item in found.values()) else 0)
    assert {"python", "packages", "data folder", "runtime folder", "cores", "numba cache", "/dev/shm"} <= set(found)
    assert all(item["do"] for item in found.values() if item["level"] != "ok")
    assert not (tmp_path / "data").exists()


def test_doctor_fails_where_data_cannot_be_written(capsys, tmp_path, monkeypatch):
    monkeypatch.setenv("FRINGED_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv("FRINGED_DATA_DIR", "/proc/nothing")
    code, out, _ = run(capsys, "doctor")
    assert code == 1
    assert "set data_dir, or FRINGED_DATA_DIR" in out


def test_plugins_lists_the_built_in_ones(capsys):
    code, out, _ = run(capsys, "plugins", "--json")
    names = {info["name"] for info in json.loads(out)}
    assert {"phase", "triangulation", "registration", "exporters"} <= names
    assert code in (0, 1)


def test_every_command_has_a_help():
    for name, command in cli.commands.items():
        assert command.help, name
    result = CliRunner().invoke(cli, ["--help"])
    assert "Exit codes" in result.output
    assert ConfigurationError("x").exit_code == 2


def test_numpy_s_blas_starts_no_threads_in_the_daemon_and_workers_are_not_told():
    code = (
        "import os; from fringed.cli.run import load_numpy_with_one_thread as load; load();"
        "import numpy as np; a = np.ones((600, 600), np.float32); a @ a;"
        "print(len(os.listdir('/proc/self/task')), 'OPENBLAS_NUM_THREADS' in os.environ)"
    )
    env = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.split() == ["1", "False"]
