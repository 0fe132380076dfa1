"""A camera's GenICam description: its XML as nodes.

Owns which nodes are read (`KINDS`) and how their elements are kept; computes no value and reads no register.
"""

from __future__ import annotations

import xml.etree.ElementTree as Tree
from collections.abc import Mapping
from dataclasses import dataclass, field

from fringed.errors import ProtocolError

REGISTERS = ("IntReg", "MaskedIntReg", "FloatReg", "StringReg", "StructEntry")
KNIVES = ("SwissKnife", "IntSwissKnife")
CONVERTERS = ("Converter", "IntConverter")
VALUES = ("Integer", "Float", "Boolean", "Enumeration", "Command")
KINDS = frozenset((*REGISTERS, *KNIVES, *CONVERTERS, *VALUES))
MAX_NODES = 50_000


@dataclass(frozen=True)
class Node:
    """A node: its elements' texts by tag, an enumeration's entries, and the names of a formula's variables.

    `indices` are the nodes that move a register, each with the bytes of a step; empty, the register's length.
    """

    kind: str
    name: str
    fields: Mapping[str, tuple[str, ...]]
    entries: Mapping[str, int] = field(default_factory=dict)
    variables: Mapping[str, str] = field(default_factory=dict)
    indices: tuple[tuple[str, str], ...] = ()

    def text(self, tag: str, default: str | None = None) -> str:
        """Return the text of one element; raises ProtocolError where it is missing and has no default."""
        found = self.fields.get(tag)
        if found:
            return found[0]
        if default is None:
            raise ProtocolError(f"the camera describes {self.name} ({self.kind}) without {tag}")
        return default

    def number(self, tag: str, default: int | None = None) -> int:
        """Return an integer element."""
        return integer(self.text(tag, None if default is None else str(default)), self.name)


def integer(text: str, name: str) -> int:
    """Return a literal of a description, decimal or hexadecimal."""
    try:
        return int(text.strip(), 0)
    except ValueError as error:
        raise ProtocolError(f"the camera describes {name} with {text!r} where a whole number is expected") from error


def parse_description(text: str) -> dict[str, Node]:
    """Return the nodes of a description by name; kinds that are not read are left out.

    Raises
    ------
    ProtocolError
        the text is no GenICam description.
    """
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ProtocolError("the camera's description declares entities; a GenICam description has none")
    try:
        root = Tree.fromstring(text)  # noqa: S314  (entities are refused above)
    except (Tree.ParseError, ValueError, LookupError) as error:
        raise ProtocolError(f"the camera's description is no XML: {error}") from error
    if _tag(root) != "RegisterDescription":
        raise ProtocolError(f"the camera's description begins with <{_tag(root)}>; expected <RegisterDescription>")
    nodes: dict[str, Node] = {}
    for element in root.iter():
        kind, name = _tag(element), element.get("Name", "")
        if kind == "StructReg":
            nodes.update({entry.name: entry for entry in _structure(element)})
        elif kind in KINDS and name and name not in nodes:
            nodes[name] = _node(element)
        if len(nodes) > MAX_NODES:
            raise ProtocolError(f"the camera describes more than {MAX_NODES} features")
    return nodes


def _tag(element: Tree.Element) -> str:
    return str(element.tag).rpartition("}")[2]


def _fields(element: Tree.Element) -> dict[str, tuple[str, ...]]:
    found: dict[str, tuple[str, ...]] = {}
    for child in element:
        tag, text = _tag(child), (child.text or "").strip()
        if tag == "IntSwissKnife" and child.get("Name"):  # a formula inside a register is a part of its address
            tag, text = "pAddress", child.get("Name", "")
        elif len(child):
            continue
        found[tag] = (*found.get(tag, ()), text)
    return found


def _node(element: Tree.Element) -> Node:
    name, entries, variables = element.get("Name", ""), {}, {}
    for child in element:
        tag = _tag(child)
        if tag == "EnumEntry" and child.get("Name"):
            entries[child.get("Name", "")] = integer(_fields(child).get("Value", ("",))[0], name)
        elif tag == "pVariable" and child.get("Name"):
            variables[child.get("Name", "")] = (child.text or "").strip()
    return Node(_tag(element), name, _fields(element), entries, variables, _indices(element))


def _indices(element: Tree.Element) -> tuple[tuple[str, str], ...]:
    return tuple(
        ((child.text or "").strip(), child.get("pOffset") or child.get("Offset") or "")
        for child in element
        if _tag(child) == "pIndex"
    )


def _structure(element: Tree.Element) -> list[Node]:
    """Return the entries of a StructReg, each with what the structure says for all."""
    shared = _fields(element)
    return [
        Node("StructEntry", child.get("Name", ""), {**shared, **_fields(child)}, indices=_indices(element))
        for child in element
        if _tag(child) == "StructEntry" and child.get("Name")
    ]
