"""CURVE keys: who may reach a station from another machine.

Owns the folder's layout: `server.key`, `server.key_secret`, `clients/NAME.key`, and for each client the folder
`for-NAME` with what is handed to it (`client.key_secret`, `server.key`). Folders are 0700, secrets 0600.
"""

from __future__ import annotations

import re
from pathlib import Path

from fringed.errors import ConfigurationError, StorageError, UsageError

_NAME = re.compile(r"[A-Za-z0-9._-]{1,64}")
SERVER = "server"


def new_keys(folder: Path, name: str) -> list[Path]:
    """Make the keys of the server, or of a client; return the files.

    Raises
    ------
    UsageError
        no such name, keys that exist already, or a client before the server.
    StorageError
        the folder cannot be written.
    """
    from zmq.auth import create_certificates

    if not _NAME.fullmatch(name):
        raise UsageError(f"{name!r} is no name for keys; use letters, digits, dots, dashes, at most 64")
    public = folder / f"{SERVER}.key" if name == SERVER else folder / "clients" / f"{name}.key"
    if public.exists():
        raise UsageError(f"{public} exists already; remove it first if these keys are to be replaced")
    if name != SERVER and not (folder / f"{SERVER}.key").exists():
        raise UsageError(f"there is no {folder / 'server.key'}; make it first: fringed keys new server --dir {folder}")
    try:
        for made in (folder, folder / "clients"):
            made.mkdir(parents=True, exist_ok=True, mode=0o700)
            made.chmod(0o700)
        if name == SERVER:
            made_public, made_secret = create_certificates(folder, SERVER)
            files = [Path(made_public), Path(made_secret)]
        else:
            files = _client(folder, name)
        for file in files:
            file.chmod(0o600 if file.name.endswith("_secret") else 0o644)
    except OSError as error:
        raise StorageError(f"the keys cannot be written to {folder}: {error}") from error
    return files


def _client(folder: Path, name: str) -> list[Path]:
    from zmq.auth import create_certificates

    own = folder / f"for-{name}"
    own.mkdir(mode=0o700)
    made_public, made_secret = map(Path, create_certificates(own, "client"))
    public = folder / "clients" / f"{name}.key"
    made_public.rename(public)
    server = own / f"{SERVER}.key"
    server.write_bytes((folder / f"{SERVER}.key").read_bytes())
    return [public, made_secret, server]


def server_keys(folder: Path) -> tuple[bytes, bytes]:
    """Return the server's public and secret key.

    Raises
    ------
    ConfigurationError
        they are missing, or others may read them; the message tells the command.
    """
    from zmq.auth import load_certificate

    secret_file = folder / f"{SERVER}.key_secret"
    try:
        public, secret = load_certificate(secret_file)
    except (OSError, ValueError) as error:
        raise ConfigurationError(
            f"tcp needs the server's keys, and {secret_file} cannot be used: {error}; make them with: "
            f"fringed keys new server --dir {folder}"
        ) from error
    if secret is None:
        raise ConfigurationError(
            f"{secret_file} holds no secret key; make it anew: fringed keys new server --dir {folder}"
        )
    for path, mode in ((folder, 0o700), (secret_file, 0o600)):
        if path.stat().st_mode & 0o077:
            raise ConfigurationError(f"others may read {path}; run: chmod {mode:o} {path}")
    if not any((folder / "clients").glob("*.key")):
        raise ConfigurationError(
            f"no client has a key in {folder / 'clients'}, so nobody could connect; make one: "
            f"fringed keys new NAME --dir {folder}"
        )
    return public, secret
