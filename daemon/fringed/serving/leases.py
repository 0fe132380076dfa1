"""Who holds the rig: one holder for each scope, with a time to live and a token.

Owns the rule, pure: time is passed in. Knows no socket. Reading is free; only what moves the rig asks here.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass, replace

from fringed.errors import LeaseError, UsageError
from fringed.messages import LeaseState

SCOPES = ("rig",)
TTL_MAX_S = 3600.0


@dataclass(frozen=True)
class Lease:
    """One lease in force."""

    holder: str
    scope: str
    token: str
    ttl_s: float
    expires_s: float


class Leases:
    """Acquire, renew, release, break; expired leases vanish by themselves."""

    def __init__(self) -> None:
        self._held: dict[str, Lease] = {}

    def acquire(self, holder: str, ttl_s: float, scope: str, now: float) -> Lease:
        """Take a free scope.

        Raises
        ------
        UsageError
            no such scope, no holder, or a time to live outside 0 to 3600 s.
        LeaseError
            somebody else holds it.
        """
        if scope not in SCOPES or not holder or not 0 < ttl_s <= TTL_MAX_S:
            raise UsageError(
                f"a lease of scope {scope!r} for {holder!r} over {ttl_s:g} s; expected a scope of {', '.join(SCOPES)}, "
                f"a holder's name, and more than 0 and at most {TTL_MAX_S:g} s"
            )
        held = self.holder_of(scope, now)
        if held is not None:
            raise self._refusal(held, now)
        lease = Lease(holder, scope, secrets.token_hex(8), ttl_s, now + ttl_s)
        self._held[scope] = lease
        return lease

    def renew(self, token: str, now: float) -> Lease:
        """Start the time to live of a lease anew; raises LeaseError when it is not in force any more."""
        lease = self._by_token(token, now)
        renewed = replace(lease, expires_s=now + lease.ttl_s)
        self._held[lease.scope] = renewed
        return renewed

    def release(self, token: str, now: float) -> Lease:
        """Give a lease back; raises LeaseError when it is not in force any more."""
        lease = self._by_token(token, now)
        del self._held[lease.scope]
        return lease

    def force(self, scope: str, now: float) -> Lease | None:
        """Break whatever lease holds `scope`: an operator's act, to be logged by the caller."""
        held = self.holder_of(scope, now)
        self._held.pop(scope, None)
        return held

    def check(self, token: str, now: float, scope: str = "rig") -> None:
        """Let pass who holds `scope`, and everybody while nobody does.

        Raises
        ------
        LeaseError
            somebody else holds it, or the given token is of a lease that is over.
        """
        held = self.holder_of(scope, now)
        if held is not None and held.token != token:
            raise self._refusal(held, now)
        if held is None and token:
            raise LeaseError(
                "the lease with this token is over (expired, released or broken); acquire a new one, or send no token"
            )

    def holder_of(self, scope: str, now: float) -> Lease | None:
        """Return the lease in force, after dropping one that expired."""
        held = self._held.get(scope)
        if held is not None and held.expires_s <= now:
            del self._held[scope]
            return None
        return held

    def state(self, now: float, scope: str = "rig") -> LeaseState | None:
        """Return what everybody may know of it."""
        held = self.holder_of(scope, now)
        return None if held is None else LeaseState(held.holder, held.scope, round(held.expires_s - now, 3))

    def _by_token(self, token: str, now: float) -> Lease:
        for scope in list(self._held):
            held = self.holder_of(scope, now)
            if held is not None and token and secrets.compare_digest(held.token.encode(), token.encode()):
                return held
        raise LeaseError(
            f"no lease with the token {token[:16]!r} is in force; it expired, was released or broken: acquire a new one"
        )

    @staticmethod
    def _refusal(held: Lease, now: float) -> LeaseError:
        return LeaseError(
            f"the {held.scope} is held by {held.holder!r} for {held.expires_s - now:.0f} s more; wait for it, "
            f"or break the lease (lease.break) if its holder is gone"
        )
