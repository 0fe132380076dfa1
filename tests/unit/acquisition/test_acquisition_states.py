from __future__ import annotations

import typing

import pytest

from fringed.acquisition.states import TABLES, check_transition
from fringed.errors import AcquisitionError
from fringed.messages import DeviceStateName


@pytest.mark.parametrize("which", TABLES)
def test_every_state_can_be_left_and_every_next_state_is_known(which):
    table = TABLES[which]
    assert all(table.values())
    assert set().union(*table.values()) <= set(table)
    assert all("ABSENT" in nexts for state, nexts in table.items() if state != "ABSENT")


def test_tables_together_know_all_states():
    assert set().union(*TABLES.values()) == set(typing.get_args(DeviceStateName))


def test_illegal_transition_says_what_is_allowed():
    check_transition("camera", "IDLE", "ARMED")
    with pytest.raises(AcquisitionError, match="from ABSENT to ACQUIRING; allowed are CONNECTING"):
        check_transition("camera", "ABSENT", "ACQUIRING")
