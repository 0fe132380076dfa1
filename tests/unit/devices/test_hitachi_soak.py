"""Many operations over a bad line, in virtual time: whatever is answered is right, whatever fails is named.

Run as a program for the figures: `python tests/unit/devices/test_hitachi_soak.py [OPERATIONS]`.
"""

from __future__ import annotations

import random
import sys

import pytest
from hitachi_lab import Lab

from fringed.emulators.cpx260_conversation import Manner
from fringed.emulators.cpx260_model import Faults
from fringed.errors import DeviceError
from fringed.protocols import hitachi_commands as codes

MANNERS = {"serial": Manner(), "wrapped": Manner(0, wrapped=True, idle_s=30.0)}


def soaked(manner, chance, operations, seed):
    """Return how many operations gave a wrong result, and how many a named error."""
    lab = Lab(manner=manner, dice=random.Random(seed), warm_up_s=2.0).lit()
    lab.projector.faults = Faults(chance=chance)
    dice, wrong, named = random.Random(seed + 1), 0, 0
    for _ in range(operations):
        try:
            wrong += not right(lab, dice)
        except DeviceError:
            named += 1
    return wrong, named


def right(lab, dice):
    registers = lab.projector.registers
    registers[codes.KEYSTONE] = dice.randrange(3)
    match dice.randrange(5):
        case 0:
            return lab.control.lamp_hours() == 812
        case 1:
            return lab.control.error().code == 0
        case 2:
            frozen = dice.random() < 0.5
            lab.control.freeze(frozen)
            return registers[codes.FREEZE] == frozen
        case 3:
            return len(lab.control.picture.problems()) == (registers[codes.KEYSTONE] != 0)
        case _:
            return lab.control.value("keystone get") == registers[codes.KEYSTONE]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("manner", MANNERS)
def test_nothing_wrong_is_believed_on_a_line_where_every_fifth_reply_fails(manner, seed):
    wrong, named = soaked(MANNERS[manner], 0.2, 600, seed)
    assert wrong == 0
    assert named < 60


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 20_000
    for name, manner in MANNERS.items():
        for chance in (0.05, 0.2):
            wrong, named = soaked(manner, chance, count, 5)
            print(f"{name}, {chance:.0%} of replies bad: {count} operations, {wrong} wrong, {named} named errors")
