"""One holder at a time; what expires, is released or broken is free again."""

import pytest

from fringed.errors import LeaseError, UsageError
from fringed.serving.leases import Leases


def test_a_second_holder_is_refused_and_told_who_holds_it():
    leases = Leases()
    leases.acquire("anna", 10.0, "rig", 0.0)
    with pytest.raises(LeaseError, match=r"held by 'anna' for 7 s more"):
        leases.acquire("ben", 10.0, "rig", 3.0)


def test_an_expired_lease_is_free_again():
    leases = Leases()
    leases.acquire("anna", 10.0, "rig", 0.0)
    assert leases.acquire("ben", 5.0, "rig", 10.0).holder == "ben"


def test_renewing_starts_the_time_to_live_anew():
    leases = Leases()
    lease = leases.acquire("anna", 10.0, "rig", 0.0)
    leases.renew(lease.token, 9.0)
    assert leases.state(18.0).expires_in_s == pytest.approx(1.0)
    with pytest.raises(LeaseError, match="acquire a new one"):
        leases.renew(lease.token, 19.5)


def test_a_released_lease_is_free_and_its_token_dead():
    leases = Leases()
    token = leases.acquire("anna", 10.0, "rig", 0.0).token
    leases.release(token, 1.0)
    assert leases.state(1.0) is None
    with pytest.raises(LeaseError):
        leases.release(token, 1.0)


def test_only_the_holder_moves_the_rig_and_everybody_does_while_it_is_free():
    leases = Leases()
    leases.check("", 0.0)
    token = leases.acquire("anna", 10.0, "rig", 0.0).token
    leases.check(token, 1.0)
    for other in ("", "guess"):
        with pytest.raises(LeaseError, match="held by 'anna'"):
            leases.check(other, 1.0)


def test_a_token_of_a_lease_that_is_over_does_not_move_the_rig_in_silence():
    leases = Leases()
    token = leases.acquire("anna", 10.0, "rig", 0.0).token
    with pytest.raises(LeaseError, match="over"):
        leases.check(token, 11.0)


def test_breaking_tells_whose_it_was_and_frees_it():
    leases = Leases()
    leases.acquire("anna", 10.0, "rig", 0.0)
    assert leases.force("rig", 1.0).holder == "anna"
    assert leases.force("rig", 1.0) is None
    assert leases.acquire("ben", 5.0, "rig", 1.0).holder == "ben"


@pytest.mark.parametrize(
    ("holder", "ttl_s", "scope"), [("", 1, "rig"), ("a", 0, "rig"), ("a", 9999, "rig"), ("a", 1, "x")]
)
def test_what_cannot_be_meant_is_refused(holder, ttl_s, scope):
    with pytest.raises(UsageError, match="expected a scope of rig"):
        Leases().acquire(holder, ttl_s, scope, 0.0)
