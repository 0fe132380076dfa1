"""Who may open a device node, and who has it open.

Owns modes, groups and access lists as they are stored; asks the kernel itself where the user is the present one.
"""

from __future__ import annotations

import grp
import os
import pwd
import stat
from dataclasses import dataclass
from pathlib import Path

from fringed.finding.reading import entries, text


@dataclass(frozen=True)
class User:
    """A user, and the groups in force: those of this process, not those of the next login."""

    name: str
    uid: int
    groups: frozenset[str]

    def to_be(self) -> frozenset[str]:
        """Return the groups that the next login has beside those in force."""
        try:
            members = {group.gr_name for group in grp.getgrall() if self.name in group.gr_mem}
        except OSError:
            return frozenset()
        return frozenset(members) - self.groups


@dataclass(frozen=True)
class Access:
    """How a node may be opened for reading and writing."""

    node: str
    owner: str
    group: str
    mode: str
    usable: bool
    has_acl: bool = False

    def __str__(self) -> str:
        extra = ", with an access list" if self.has_acl else ""
        return f"{self.mode} {self.owner}:{self.group}{extra}"


@dataclass(frozen=True)
class Holder:
    """A process that has a node open."""

    pid: int
    program: str

    def __str__(self) -> str:
        return f"{self.program or 'a program'} (process {self.pid})"


def current_user() -> User:
    """Return who runs this process."""
    gids = {os.getegid(), *os.getgroups()}
    return User(_user_name(os.geteuid()), os.geteuid(), frozenset(_group_name(gid) for gid in gids))


def access(root: Path, node: str, user: User) -> Access | None:
    """Return who may open `node`; None where it is not there."""
    path = root / node.lstrip("/")
    try:
        found = path.stat()
    except OSError:
        return None
    group, has_acl = _group_name(found.st_gid), _has_acl(path)
    if user.uid == os.geteuid() and user.uid != 0:
        usable = os.access(path, os.R_OK | os.W_OK, effective_ids=True)
    else:
        usable = _by_mode(found, group, user)
    return Access(node, _user_name(found.st_uid), group, f"{stat.S_IMODE(found.st_mode):04o}", usable, has_acl)


def _by_mode(found: os.stat_result, group: str, user: User) -> bool:
    if user.uid == 0:
        return True
    if found.st_uid == user.uid:
        return found.st_mode & 0o600 == 0o600
    if group in user.groups:
        return found.st_mode & 0o060 == 0o060
    return found.st_mode & 0o006 == 0o006


def holders(root: Path, node: str) -> tuple[Holder, ...]:
    """Return who has `node` open, as far as this user may look: others' processes are closed to all but root."""
    found = []
    for process in entries(root / "proc"):
        if process.name.isdigit() and any(_leads_to(link, node) for link in _descriptors(process)):
            found.append(Holder(int(process.name), text(process / "comm")))
    return tuple(found)


def _descriptors(process: Path) -> list[Path]:
    try:
        return list((process / "fd").iterdir())
    except OSError:
        return []


def _leads_to(link: Path, node: str) -> bool:
    try:
        return str(link.readlink()) == node
    except OSError:
        return False


def _has_acl(path: Path) -> bool:
    try:
        return "system.posix_acl_access" in os.listxattr(path)
    except OSError:
        return False


def _user_name(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


def _group_name(gid: int) -> str:
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)
