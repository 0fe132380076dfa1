"""Features of a camera by name: its description's nodes over its memory.

Owns how a node becomes registers and back. Memory is passed in: no port is known here.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from typing import Literal, Protocol

from fringed.errors import ProtocolError
from fringed.protocols.u3v_formula import Number, evaluate
from fringed.protocols.u3v_genapi import CONVERTERS, KNIVES, Node, integer

_DEEPEST = 24
_GREATEST = 1e38  # a float register of 4 bytes holds no more
_REGISTER_BYTES = (1, 2, 4, 8)


class Memory(Protocol):
    """A device's memory."""

    def read(self, address: int, count: int) -> bytes:
        """Return `count` bytes at `address`."""
        ...

    def write(self, address: int, data: bytes) -> None:
        """Write `data` at `address`."""


class Features:
    """Get, set and execute features; raises ProtocolError, with the feature's name, for what cannot be done."""

    def __init__(self, nodes: Mapping[str, Node], memory: Memory) -> None:
        self._nodes, self._memory = nodes, memory
        self._local: dict[str, Number] = {}

    def has(self, *names: str) -> bool:
        """Whether the camera describes all of these."""
        return all(name in self._nodes for name in names)

    def choices(self, name: str) -> tuple[str, ...]:
        """Return an enumeration's entries; none where there is no such enumeration."""
        node = self._nodes.get(name)
        return tuple(node.entries) if node is not None else ()

    def number(self, name: str) -> Number:
        """Return a number, or an enumeration's."""
        return self._get(self._node(name), 0)

    def whole(self, name: str) -> int:
        """Return a whole number."""
        return int(self.number(name))

    def choice(self, name: str) -> str:
        """Return the name of an enumeration's entry in force."""
        node, value = self._node(name), self.whole(name)
        found = next((entry for entry, number in node.entries.items() if number == value), None)
        if found is None:
            raise ProtocolError(f"the camera's {name} is {value}, which its description does not name")
        return found

    def limits(self, name: str) -> tuple[Number, Number]:
        """Return the least and the greatest value, infinite where the camera does not tell."""
        node = self._node(name)
        return self._limit(node, "Min", -math.inf), self._limit(node, "Max", math.inf)

    def set(self, name: str, value: Number | str) -> None:
        """Set a number, or an enumeration by its entry's name."""
        node = self._node(name)
        if isinstance(value, str):
            if value not in node.entries:
                raise ProtocolError(
                    f"the camera's {name} cannot be {value!r}; it has {', '.join(node.entries) or 'none'}"
                )
            value = node.entries[value]
        elif node.kind in ("Integer", "Float"):
            low, high = self.limits(name)
            if not low <= value <= high:
                raise ProtocolError(f"the camera's {name} cannot be {value:g}; it goes from {low:g} to {high:g}")
        self._set(node, value, 0)

    def execute(self, name: str) -> None:
        """Execute a command."""
        node = self._node(name)
        if node.kind != "Command":
            raise ProtocolError(f"the camera's {name} is a {node.kind}; a command is expected")
        value = self._get(self._node(node.text("pCommandValue")), 1) if "pCommandValue" in node.fields else None
        self._set(node, node.number("CommandValue", 1) if value is None else value, 0)

    def _node(self, name: str) -> Node:
        node = self._nodes.get(name)
        if node is None:
            raise ProtocolError(
                f"the camera has no {name} that can be read here; its maker's viewer shows which features it has"
            )
        return node

    def _limit(self, node: Node, tag: str, default: float) -> Number:
        if tag in node.fields:
            return _literal(node.text(tag), node.name)
        if "p" + tag in node.fields:
            return self._get(self._node(node.text("p" + tag)), 1)
        return default

    def _get(self, node: Node, depth: int) -> Number:
        _not_too_deep(node, depth)
        if node.kind in KNIVES:
            return evaluate(node.text("Formula"), self._variables(node, {}, depth), node.kind == "IntSwissKnife")
        if node.kind in CONVERTERS:
            raw = self._get(self._node(node.text("pValue")), depth + 1)
            found = self._variables(node, {"TO": raw}, depth)
            return evaluate(node.text("FormulaFrom"), found, node.kind == "IntConverter")
        if "pValue" in node.fields:
            return self._get(self._node(node.text("pValue")), depth + 1)
        if "Value" in node.fields:
            return self._local.get(node.name, _literal(node.text("Value"), node.name))
        return self._read(node, depth)

    def _set(self, node: Node, value: Number, depth: int) -> None:
        _not_too_deep(node, depth)
        if node.kind in KNIVES:
            raise ProtocolError(f"the camera's {node.name} is computed ({node.kind}) and cannot be set")
        if node.kind in CONVERTERS:
            found = self._variables(node, {"FROM": value}, depth)
            value = evaluate(node.text("FormulaTo"), found, node.kind == "IntConverter")
            self._set(self._node(node.text("pValue")), value, depth + 1)
        elif "pValue" in node.fields:
            self._set(self._node(node.text("pValue")), value, depth + 1)
        elif "Value" in node.fields:
            self._local[node.name] = value
        else:
            self._write(node, value, depth)

    def _variables(self, node: Node, given: Mapping[str, Number], depth: int) -> Callable[[str], Number]:
        def variable(name: str) -> Number:
            if name in given:
                return given[name]
            if name in node.variables:
                return self._get(self._node(node.variables[name]), depth + 1)
            raise ProtocolError(f"the camera's formula of {node.name} names {name!r}, which it does not define")

        return variable

    def _place(self, node: Node, depth: int) -> tuple[int, int]:
        """Return a register's address and length."""
        if not node.fields.keys() & {"Address", "pAddress"}:
            raise ProtocolError(f"the camera describes {node.name} ({node.kind}) in a way that is not read here")
        address = sum(integer(text, node.name) for text in node.fields.get("Address", ()))
        address += sum(int(self._get(self._node(name), depth + 1)) for name in node.fields.get("pAddress", ()))
        moved = "pLength" in node.fields
        length = int(self._get(self._node(node.text("pLength")), depth + 1)) if moved else node.number("Length")
        for name, step in node.indices:
            each = length if not step else self._step(step, node, depth)
            address += int(self._get(self._node(name), depth + 1)) * each
        return address, length

    def _step(self, step: str, node: Node, depth: int) -> int:
        return int(self._get(self._nodes[step], depth + 1)) if step in self._nodes else integer(step, node.name)

    def _read(self, node: Node, depth: int) -> Number:
        address, length = self._place(node, depth)
        if node.kind == "FloatReg":
            return float(struct.unpack(_float(node, length), self._memory.read(address, length))[0])
        _check_length(node, length)
        whole = int.from_bytes(self._memory.read(address, length), _order(node))
        shift, width = _bits(node, length)
        value = whole >> shift & (1 << width) - 1
        return value - (1 << width) if _signed(node) and value >> (width - 1) else value

    def _write(self, node: Node, value: Number, depth: int) -> None:
        address, length = self._place(node, depth)
        if node.text("AccessMode", "RW") == "RO":
            raise ProtocolError(f"the camera's {node.name} can only be read")
        if not abs(value) < _GREATEST:
            raise ProtocolError(f"the camera's {node.name} cannot hold {value:g}")
        if node.kind == "FloatReg":
            self._memory.write(address, struct.pack(_float(node, length), float(value)))
            return
        _check_length(node, length)
        shift, width = _bits(node, length)
        number, least = round(value), -(1 << (width - 1)) if _signed(node) else 0
        if not least <= number < least + (1 << width):
            raise ProtocolError(
                f"the camera's {node.name} cannot hold {value:g}; it goes from {least} to {least + 2**width - 1}"
            )
        word = (number & (1 << width) - 1) << shift
        if width < 8 * length and node.text("AccessMode", "RW") != "WO":
            before = int.from_bytes(self._memory.read(address, length), _order(node))
            word |= before & ~(((1 << width) - 1) << shift)
        self._memory.write(address, word.to_bytes(length, _order(node)))


def _literal(text: str, name: str) -> Number:
    try:
        return int(text, 0)
    except ValueError:
        pass
    try:
        return float(text)
    except ValueError as error:
        raise ProtocolError(f"the camera describes {name} with {text!r} where a number is expected") from error


def _not_too_deep(node: Node, depth: int) -> None:
    if depth > _DEEPEST:
        raise ProtocolError(f"the camera's {node.name} refers to itself, or through more than {_DEEPEST} others")


def _order(node: Node) -> Literal["little", "big"]:
    return "big" if node.text("Endianess", "LittleEndian") == "BigEndian" else "little"


def _signed(node: Node) -> bool:
    return node.text("Sign", "Unsigned") == "Signed"


def _float(node: Node, length: int) -> str:
    if length not in (4, 8):
        raise ProtocolError(f"the camera describes {node.name} as a float of {length} bytes; 4 and 8 exist")
    return (">" if _order(node) == "big" else "<") + ("f" if length == 4 else "d")


def _check_length(node: Node, length: int) -> None:
    if node.kind == "StringReg" or length not in _REGISTER_BYTES:
        raise ProtocolError(f"the camera's {node.name} ({node.kind} of {length} bytes) is no number that is read here")


def _bits(node: Node, length: int) -> tuple[int, int]:
    """Return a register's lowest bit and how many it has; big-endian ones count from the other end (GenApi 2.8.5)."""
    if node.kind not in ("MaskedIntReg", "StructEntry"):
        return 0, 8 * length
    low = node.number("Bit") if "Bit" in node.fields else node.number("LSB")
    high = low if "Bit" in node.fields else node.number("MSB")
    if _order(node) == "big":
        low, high = 8 * length - 1 - low, 8 * length - 1 - high
    low, high = min(low, high), max(low, high)
    if not 0 <= low <= high < 8 * length:
        raise ProtocolError(f"the camera describes {node.name} with the bits {low} to {high} of {8 * length}")
    return low, high - low + 1
