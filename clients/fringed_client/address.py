"""Where a station is: a runtime folder on this machine, or tcp with CURVE keys.

Owns the rules that turn what a person writes into ZeroMQ addresses; opens no socket.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

from fringed.config.paths import IPC_PATH_MAX, endpoint, runtime_dir
from fringed.errors import UsageError

DEFAULT_CONTROL_PORT = 7601
_TCP = re.compile(r"^tcp://(?P<host>\[[0-9a-fA-F:]+\]|[^\s:/]+)(?::(?P<port>\d{1,5}))?$")


@dataclass(frozen=True)
class Keys:
    """CURVE keys of one connection, in Z85."""

    server_public: bytes
    client_public: bytes
    client_secret: bytes

    @classmethod
    def load(cls, folder: Path) -> Keys:
        """Read `server.key` (public) and `client.key_secret` as zmq.auth writes them.

        Raises
        ------
        UsageError
            a file is missing or holds no key.
        """
        from zmq.auth import load_certificate

        missing = [name for name in ("server.key", "client.key_secret") if not (folder / name).is_file()]
        if missing:
            raise UsageError(
                f"tcp needs CURVE keys: {' and '.join(missing)} not in {folder}; make them with `fringed keys new` "
                "(the station's public key is server.key), or name their folder with FRINGED_KEYS or keys="
            )
        try:
            server, _ = load_certificate(folder / "server.key")
            public, secret = load_certificate(folder / "client.key_secret")
        except (OSError, ValueError) as error:
            raise UsageError(
                f"no CURVE keys in {folder}: {error}; tcp needs server.key (the station's public key) and "
                "client.key_secret there: name the folder with FRINGED_KEYS or keys="
            ) from error
        if secret is None:
            raise UsageError(f"{folder / 'client.key_secret'} holds no secret key; copy the file that ends in _secret")
        return cls(server, public, secret)


@dataclass(frozen=True)
class Address:
    """A station's control socket; `keys` are set for tcp. `runtime` is empty for tcp."""

    control: str
    runtime: str = ""
    keys: Keys | None = None

    def __str__(self) -> str:
        return self.runtime or self.control

    @classmethod
    def of(cls, where: str | Path | Address | None = None, keys: str | Path | None = None) -> Address:
        """Return the address that a person means.

        Parameters
        ----------
        where
            a runtime folder, `tcp://host[:port]`, or None: $FRINGED_STATION, else the usual folder.
        keys
            folder of the CURVE keys for tcp; None: $FRINGED_KEYS, else ~/.config/fringed/keys.

        Raises
        ------
        UsageError
            an address of another kind, or tcp without keys.
        """
        if isinstance(where, Address):
            return where
        text = str(where) if where else os.environ.get("FRINGED_STATION", "")
        if "://" in text and not text.startswith("ipc://"):
            return cls._tcp(text, keys)
        folder = runtime_dir(text.removeprefix("ipc://").removesuffix("/control"))
        if len(str(folder / "control")) > IPC_PATH_MAX:
            raise UsageError(
                f"the runtime folder {folder} makes a socket path of more than {IPC_PATH_MAX} characters; "
                "use a shorter one"
            )
        return cls(endpoint(folder, "control"), str(folder))

    @classmethod
    def _tcp(cls, text: str, keys: str | Path | None) -> Address:
        match = _TCP.match(text)
        if match is None or not 0 < int(match["port"] or DEFAULT_CONTROL_PORT) < 65536:
            raise UsageError(
                f"{text!r} is no station's address; expected a runtime folder or tcp://host:port, such as "
                f"tcp://host:{DEFAULT_CONTROL_PORT}"
            )
        folder = Path(keys or os.environ.get("FRINGED_KEYS") or "~/.config/fringed/keys").expanduser()
        return cls(f"tcp://{match['host']}:{match['port'] or DEFAULT_CONTROL_PORT}", "", Keys.load(folder))

    def stream(self, announced: str) -> str:
        """Return the address of the stream, given the one that the station announced in its hello."""
        if self.runtime:
            return endpoint(Path(self.runtime), "stream")
        host = self.control.rpartition(":")[0]
        return f"{host}:{announced.rpartition(':')[2]}"

    def exists(self) -> bool:
        """Tell whether something could serve there; tcp can only be tried."""
        return not self.runtime or (Path(self.runtime) / "control").exists()
