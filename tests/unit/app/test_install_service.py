"""`fringed install-service`: what it would do, what it does, and that a failure half way leaves nothing behind."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fringed.cli import install_service
from fringed.cli.install_files import Back, Step, Transaction, Wanted, plan_install
from fringed.cli.install_service import CONFIG, DISABLE, ENABLE, NAMES, RULES, UNIT, service_files, wanted_files
from fringed.cli.main import main
from fringed.errors import StorageError, UsageError
from fringed.finding.naming import named_ids

PROGRAM = "/opt/fringed/bin/fringed"


def run(capsys, *arguments):
    code = 0
    try:
        main(list(arguments))
    except SystemExit as ended:
        code = ended.code
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def install(capsys, root, *more):
    return run(capsys, "install-service", "--root", str(root), "--program", PROGRAM, *more)


def tree(root: Path) -> dict[str, tuple[int, bytes | str]]:
    """Return every file and link below `root`, with its mode and content."""
    return {
        str(path.relative_to(root)): (path.lstat().st_mode, _content(path)) for path in sorted(root.rglob("*"))
    }  # fmt: skip


def _content(path: Path) -> bytes | str:
    if path.is_symlink():
        return str(path.readlink())
    return path.read_bytes() if path.is_file() else ""


def test_dry_run_says_all_and_does_nothing(capsys, tmp_path):
    code, out, _ = install(capsys, tmp_path, "--projector", "1-3.2")
    assert code == 0 and tree(tmp_path) == {}
    for path in (UNIT, RULES, NAMES, CONFIG):
        assert f"write    {path}" in out
    assert f"       | ExecStart={PROGRAM} run --config {CONFIG}" in out
    assert 'SYMLINK+="fringed/projector"' in out
    assert "systemctl enable --now fringed.service" in out and "udevadm control --reload" in out
    assert "dry run" in out


def test_every_line_that_the_dry_run_shows_is_what_is_written(capsys, tmp_path):
    _, out, _ = install(capsys, tmp_path, "--camera", "CAM1")
    install(capsys, tmp_path, "--camera", "CAM1", "--yes")
    shown = [line.removeprefix("       | ") for line in out.splitlines() if line.startswith("       | ")]
    paths = [line.split()[1] for line in out.splitlines() if line.startswith("write ")]
    written = [line for path in paths for line in (tmp_path / path[1:]).read_text().splitlines()]
    assert shown == written


def test_files_are_written_and_nothing_is_run_below_a_root(capsys, tmp_path, monkeypatch):
    monkeypatch.setattr(install_service, "run_command", lambda command: pytest.fail(f"ran {command}"))
    code, out, _ = install(capsys, tmp_path, "--yes")
    assert code == 0 and "not run  systemctl daemon-reload" in out
    assert (tmp_path / UNIT[1:]).read_text().count("ExecStart=") == 1
    assert (tmp_path / CONFIG[1:]).stat().st_mode & 0o777 == 0o640
    assert (tmp_path / RULES[1:]).read_bytes() == (service_files() / "60-fringed.rules").read_bytes()
    assert not (tmp_path / NAMES[1:]).exists()


def test_configuration_that_is_written_is_good_and_is_never_touched_again(capsys, tmp_path):
    install(capsys, tmp_path, "--yes")
    assert run(capsys, "check", str(tmp_path / CONFIG[1:]))[0] == 0
    (tmp_path / CONFIG[1:]).write_text('name = "ours"\n')
    code, out, _ = install(capsys, tmp_path, "--yes", "--force", "--projector", "FTA1")
    assert code == 0 and f"yours    {CONFIG}" in out
    assert (tmp_path / CONFIG[1:]).read_text() == 'name = "ours"\n'
    run(capsys, "uninstall-service", "--root", str(tmp_path), "--yes", "--force")
    assert (tmp_path / CONFIG[1:]).read_text() == 'name = "ours"\n'


def test_second_installation_changes_nothing(capsys, tmp_path):
    install(capsys, tmp_path, "--yes")
    before = tree(tmp_path)
    code, out, _ = install(capsys, tmp_path, "--yes")
    assert code == 0 and "in place already" in out and tree(tmp_path) == before


def test_newer_files_of_ours_replace_older_ones(capsys, tmp_path):
    install(capsys, tmp_path, "--yes", "--projector", "FTA1")
    code, out, _ = install(capsys, tmp_path, "--yes", "--projector", "FTB2")
    assert code == 0 and f"replace  {NAMES}" in out
    assert "FTB2" in (tmp_path / NAMES[1:]).read_text() and "FTA1" not in (tmp_path / NAMES[1:]).read_text()


def test_name_of_one_device_is_changed_without_the_other_s(capsys, tmp_path):
    install(capsys, tmp_path, "--yes", "--projector", "FTA1", "--camera", "CAM1")
    install(capsys, tmp_path, "--yes", "--projector", "FTB2")
    assert named_ids((tmp_path / NAMES[1:]).read_text()) == {"projector": "FTB2", "camera": "CAM1"}
    install(capsys, tmp_path, "--yes", "--camera", "none")
    assert named_ids((tmp_path / NAMES[1:]).read_text()) == {"projector": "FTB2"}
    code, _, err = install(capsys, tmp_path, "--yes", "--camera", "FTB2")
    assert code == 2 and "each needs its own" in err


def test_installation_that_was_killed_is_finished_by_the_next(capsys, tmp_path):
    install(capsys, tmp_path, "--yes")
    (tmp_path / "etc/fringed/installed.json").unlink()
    (tmp_path / RULES[1:]).unlink()
    assert install(capsys, tmp_path, "--yes")[0] == 0
    assert run(capsys, "uninstall-service", "--root", str(tmp_path), "--yes")[0] == 0
    assert not (tmp_path / UNIT[1:]).exists()


def test_changed_file_is_not_overwritten_without_force(capsys, tmp_path):
    install(capsys, tmp_path, "--yes")
    unit = tmp_path / UNIT[1:]
    unit.write_text(unit.read_text() + "# ours\n")
    before = tree(tmp_path)
    code, _, err = install(capsys, tmp_path, "--yes", "--projector", "FTA1")
    assert code == 2 and UNIT in err and "--force" in err and tree(tmp_path) == before
    code, out, _ = install(capsys, tmp_path)
    assert code == 0 and f"CHANGED  {UNIT}" in out and "| -# ours" in out
    assert install(capsys, tmp_path, "--yes", "--force")[0] == 0
    assert "# ours" not in unit.read_text()


def test_file_of_somebody_else_is_not_overwritten(capsys, tmp_path):
    rules = tmp_path / RULES[1:]
    rules.parent.mkdir(parents=True)
    rules.write_text("# somebody else's\n")
    assert install(capsys, tmp_path, "--yes")[0] == 2
    assert rules.read_text() == "# somebody else's\n" and not (tmp_path / UNIT[1:]).exists()


def test_masked_unit_counts_as_changed(capsys, tmp_path):
    unit = tmp_path / UNIT[1:]
    unit.parent.mkdir(parents=True)
    unit.symlink_to("/dev/null")
    assert install(capsys, tmp_path, "--yes")[0] == 2
    assert unit.is_symlink()


def test_uninstall_removes_what_was_installed_and_keeps_the_configuration(capsys, tmp_path):
    (tmp_path / "etc/udev/rules.d").mkdir(parents=True)
    (tmp_path / "etc/udev/rules.d/99-own.rules").write_text("# own\n")
    install(capsys, tmp_path, "--yes", "--projector", "FTA1")
    install(capsys, tmp_path, "--yes")  # without names: those that are there stay, and stay listed
    code, out, _ = run(capsys, "uninstall-service", "--root", str(tmp_path))
    assert code == 0 and "dry run" in out and (tmp_path / UNIT[1:]).exists()
    code, out, _ = run(capsys, "uninstall-service", "--root", str(tmp_path), "--yes")
    left = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert code == 0 and left == {"etc/udev/rules.d/99-own.rules", CONFIG[1:]}
    code, out, _ = run(capsys, "uninstall-service", "--root", str(tmp_path), "--yes")
    assert code == 0 and "nothing was installed" in out


def test_uninstall_refuses_changed_files_without_force(capsys, tmp_path):
    install(capsys, tmp_path, "--yes")
    (tmp_path / RULES[1:]).write_text("# changed\n")
    (tmp_path / UNIT[1:]).unlink()
    code, _, err = run(capsys, "uninstall-service", "--root", str(tmp_path), "--yes")
    assert code == 2 and RULES in err and (tmp_path / RULES[1:]).exists()
    assert run(capsys, "uninstall-service", "--root", str(tmp_path), "--yes", "--force")[0] == 0
    assert not (tmp_path / RULES[1:]).exists()


class Commands:
    """Record commands, and fail at one of them, once."""

    def __init__(self, failing=None):
        self.failing, self.ran = failing, []

    def __call__(self, command):
        self.ran.append(command)
        if command == self.failing:
            self.failing = None
            raise StorageError(f"`{' '.join(command)}` failed with code 1: no")


@pytest.fixture
def as_machine(tmp_path, monkeypatch):
    """Let a folder be the machine's /, with commands that only the test sees."""

    def make(failing=None):
        commands = Commands(failing)
        monkeypatch.setattr(install_service, "_base", lambda root: tmp_path)
        monkeypatch.setattr(install_service, "_ready_to_run", lambda root: commands)
        return commands

    return make


def install_here(force=False):
    program = Path(sys.executable)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(install_service, "_HIDDEN", ("/home",))
        return install_service.install(None, {}, program, Path(CONFIG), yes=True, force=force)


@pytest.mark.parametrize("failing", install_service.INSTALL_COMMANDS, ids=lambda command: "-".join(command)[:30])
def test_command_that_fails_leaves_nothing_behind(as_machine, tmp_path, failing):
    commands = as_machine(failing)
    with pytest.raises(StorageError, match=r"failed with code 1: no; everything is as it was before"):
        install_here()
    assert tree(tmp_path) == {}
    assert (DISABLE in commands.ran) == (failing == ENABLE)


def test_failed_update_restores_the_older_files_and_leaves_the_service_enabled(as_machine, tmp_path):
    as_machine()
    install_here()
    (tmp_path / CONFIG[1:]).write_text("# ours\n")
    unit = tmp_path / UNIT[1:]
    unit.write_text("# changed by somebody\n")
    unit.chmod(0o600)
    before = tree(tmp_path)
    commands = as_machine(("systemctl", "daemon-reload"))
    with pytest.raises(StorageError):
        install_here(force=True)
    assert tree(tmp_path) == before and DISABLE not in commands.ran


def test_failed_removal_restores_everything_and_starts_the_service_again(as_machine, tmp_path):
    as_machine()
    install_here()
    before = tree(tmp_path)
    commands = as_machine(("udevadm", "control", "--reload"))
    with pytest.raises(StorageError, match="udevadm control --reload"):
        install_service.uninstall(None, yes=True, force=False)
    assert tree(tmp_path) == before
    assert commands.ran[0] == DISABLE and commands.ran[-1] == ENABLE


def test_what_cannot_be_undone_is_said(as_machine, tmp_path, monkeypatch):
    as_machine(ENABLE)
    real = Path.unlink

    def unlink(self, missing_ok=False):
        if self.name == "fringed.service":
            raise PermissionError(13, "Permission denied", str(self))
        real(self, missing_ok)

    monkeypatch.setattr(Path, "unlink", unlink)
    with pytest.raises(StorageError, match=r"not undone: .*fringed\.service: Permission denied"):
        install_here()


@pytest.mark.parametrize("place", ["etc", "etc/udev", "etc/fringed"])
def test_file_where_a_folder_should_be(capsys, tmp_path, place):
    target = tmp_path / place
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text("a file\n")
    before = tree(tmp_path)
    code, _, err = install(capsys, tmp_path, "--yes")
    assert code != 0 and "fringed:" in err and "mistake in fringed" not in err
    assert tree(tmp_path) == before


def test_folder_where_a_file_should_be(capsys, tmp_path):
    (tmp_path / UNIT[1:]).mkdir(parents=True)
    code, _, err = install(capsys, tmp_path, "--yes", "--force")
    assert code == 2 and "is a folder" in err and not (tmp_path / RULES[1:]).exists()


def in_namespace(tmp_path, options: str) -> subprocess.CompletedProcess[str]:
    """Install below a file system of its own with these mount options."""
    unshare = shutil.which("unshare")
    if unshare is None:
        pytest.skip("unshare is needed to mount a small file system")
    flags = ["-m"] if os.geteuid() == 0 else ["-rm"]
    script = (
        'mount -t tmpfs -o "$1" none "$2" || exit 99; "$3" -m fringed install-service --yes --root "$2" '
        f'--program {PROGRAM}; code=$?; find "$2" -type f; exit $code'
    )
    command = [unshare, *flags, "sh", "-c", script, "sh", options, str(tmp_path), sys.executable]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=100)
    if done.returncode == 99 or "unshare" in done.stderr:
        pytest.skip(f"nothing may be mounted here: {done.stderr.strip()}")
    return done


@pytest.mark.parametrize("options", ["size=12k", "size=1m,nr_inodes=8"])
def test_full_disk_leaves_nothing_behind(tmp_path, options):
    done = in_namespace(tmp_path, options)
    assert done.returncode == 1 and done.stdout == "", done.stdout + done.stderr
    assert "No space left on device; everything is as it was before. Make room" in done.stderr


def test_read_only_file_system(tmp_path):
    done = in_namespace(tmp_path, "ro")
    assert done.returncode == 1 and done.stdout == ""
    assert "Read-only file system; everything is as it was before" in done.stderr


def test_folder_without_permission(tmp_path):
    setpriv = shutil.which("setpriv")
    if os.geteuid() == 0 and setpriv is None:
        pytest.skip("setpriv is needed to take root's rights away")
    drop = [str(setpriv), "--bounding-set=-dac_override", "--inh-caps=-dac_override"] if os.geteuid() == 0 else []
    tmp_path.chmod(0o555)
    command = [*drop, sys.executable, "-m", "fringed", "install-service", "--yes", "--root", str(tmp_path)]
    done = subprocess.run([*command, "--program", PROGRAM], capture_output=True, text=True, check=False, timeout=100)
    tmp_path.chmod(0o755)
    assert done.returncode == 1 and tree(tmp_path) == {}
    assert "Permission denied; everything is as it was before. Run it as root" in done.stderr


def test_no_permission_says_to_be_root(capsys, tmp_path, monkeypatch):
    def mkstemp(*_, **kinds):
        raise PermissionError(13, "Permission denied", str(kinds["dir"]))

    monkeypatch.setattr("fringed.cli.install_files.tempfile.mkstemp", mkstemp)
    code, _, err = install(capsys, tmp_path, "--yes")
    assert code == 1 and "Permission denied" in err and "sudo" in err and tree(tmp_path) == {}


def test_real_machine_needs_root_and_systemd(monkeypatch):
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(UsageError, match="needs root; run: sudo"):
        install_service._ready_to_run(None)
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    if not Path("/run/systemd/system").is_dir():
        with pytest.raises(UsageError, match="systemd does not run"):
            install_service._ready_to_run(None)


def test_command_that_fails_or_is_missing_says_what_it_said():
    with pytest.raises(StorageError, match=r"code 3: a word"):
        install_service.run_command(("sh", "-c", "echo a word >&2; exit 3"))
    with pytest.raises(StorageError, match="could not be run"):
        install_service.run_command(("/nowhere/systemctl",))
    install_service.run_command(("true",))


@pytest.mark.parametrize("program", ["relative/fringed", "/opt/a b/fringed", "/opt/%h/fringed", "/opt/x;y"])
def test_program_that_cannot_stand_in_a_unit_is_refused(capsys, tmp_path, program):
    code, _, err = run(capsys, "install-service", "--root", str(tmp_path), "--program", program, "--yes")
    assert code == 2 and "cannot stand in a unit" in err and tree(tmp_path) == {}


def test_program_that_the_service_could_not_see_is_refused(capsys, tmp_path):
    code, _, err = run(capsys, "install-service", "--program", "/nowhere/fringed")
    assert code == 2 and "no program" in err
    program = tmp_path / "fringed"  # /tmp is private to the service
    program.write_text("#!/usr/bin/python3\n")
    if program.is_relative_to("/tmp"):
        code, _, err = run(capsys, "install-service", "--program", str(program))
        assert code == 2 and "hides /tmp" in err


def test_interpreter_in_a_hidden_folder_is_refused_too(tmp_path, monkeypatch):
    monkeypatch.setattr(install_service, "_HIDDEN", ("/somewhere",))
    program = tmp_path / "fringed"
    program.write_text("#!/somewhere/bin/python3 -I\n")
    with pytest.raises(UsageError, match="cannot see /somewhere/bin/python3"):
        install_service._program(program, False)


def test_configuration_that_the_service_could_not_see_is_refused(capsys, tmp_path):
    code, _, err = install(capsys, tmp_path, "--config", "/home/ann/station.toml", "--yes")
    assert code == 2 and "/home/ann/station.toml" in err
    code, _, _ = install(capsys, tmp_path, "--config", "/srv/station.toml", "--yes")
    assert code == 0 and "--config /srv/station.toml" in (tmp_path / UNIT[1:]).read_text()


def test_root_with_links_that_lead_out_of_it_is_refused(capsys, tmp_path):
    outside, root = tmp_path / "outside", tmp_path / "root"
    outside.mkdir()
    root.mkdir()
    (root / "etc").symlink_to(outside)
    code, _, err = install(capsys, root, "--yes")
    assert code == 2 and "out of" in err and not list(outside.iterdir())


def test_missing_root_is_refused(capsys, tmp_path):
    assert install(capsys, tmp_path / "nowhere", "--yes")[0] == 2


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"files": 3}', "\xff"])
def test_broken_list_of_files_is_said(capsys, tmp_path, text):
    path = tmp_path / "etc/fringed/installed.json"
    path.parent.mkdir(parents=True)
    path.write_text(text, encoding="latin-1")
    code, _, err = install(capsys, tmp_path, "--yes")
    assert code == 1 and "installed.json cannot be read" in err


def test_list_of_files_has_their_digests(capsys, tmp_path):
    install(capsys, tmp_path, "--yes", "--projector", "1-2")
    files = json.loads((tmp_path / "etc/fringed/installed.json").read_text())["files"]
    assert set(files) == {UNIT, RULES, NAMES, "/etc/sysusers.d/fringed.conf", "/etc/tmpfiles.d/fringed.conf"}


def test_interruption_is_undone_too(tmp_path):
    def interrupted(command):
        raise KeyboardInterrupt

    steps = [Step("/a", "write", Wanted("/a", b"1"))]
    with pytest.raises(StorageError, match="interrupted; everything is as it was"):
        Transaction(tmp_path, interrupted).carry_out(steps, (), (("x",),), Back())
    assert tree(tmp_path) == {}


def test_plan_of_nothing_is_empty(tmp_path):
    assert plan_install(tmp_path, []) == []


def test_unit_is_valid_as_it_is_written(tmp_path):
    analyze = shutil.which("systemd-analyze")
    if analyze is None:
        pytest.skip("systemd-analyze is not installed here")
    files = {item.path: item.content for item in wanted_files({}, Path(sys.executable), Path(CONFIG))}
    unit = tmp_path / "fringed.service"
    unit.write_bytes(files[UNIT])
    done = subprocess.run([analyze, "verify", str(unit)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
