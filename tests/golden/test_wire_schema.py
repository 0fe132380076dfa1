"""docs/wire.schema.json is today's: every kind of body, and every golden message is valid by it.

To write it again: FRINGED_WRITE_GOLDEN=1 pytest tests/golden
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import msgspec
import pytest
from golden_messages import examples

from fringed.wire import DTYPES, KINDS, VERSION, encode

PAGE = Path(__file__).resolve().parents[2] / "docs" / "wire.schema.json"
ARRAY = {"$ref": "#/$defs/Array"}


def schema() -> dict[str, Any]:
    """Return the JSON Schema of a message's header."""
    _, components = msgspec.json.schema_components(
        list(KINDS.values()), schema_hook=lambda _: {"$ref": "#/$defs/Array"}, ref_template="#/$defs/{name}"
    )
    definitions = {name: with_specials(body) for name, body in components.items()}
    definitions["Array"] = {
        "description": "an array: the path of one of `buffers`",
        "type": "object", "properties": {"$array": {"type": "string"}}, "required": ["$array"],
    }  # fmt: skip
    definitions["NotFinite"] = {
        "description": "a number that JSON lacks",
        "type": "object", "properties": {"$float": {"enum": ["nan", "inf", "-inf"]}}, "required": ["$float"],
    }  # fmt: skip
    buffer = {
        "type": "object",
        "properties": {
            "path": {"type": "string"},
            "dtype": {"enum": sorted(DTYPES)},
            "shape": {"type": "array", "items": {"type": "integer", "minimum": 0}},
            "xxh3": {"type": "string", "pattern": "^[0-9a-f]{16}$"},
        },
        "required": ["path", "dtype", "shape", "xxh3"],
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"Header of a fringed message, protocol version {VERSION}",
        "type": "object",
        "properties": {
            "v": {"const": VERSION},
            "kind": {"enum": sorted(KINDS)},
            "seq": {"type": "integer"},
            "body": {"anyOf": [{"$ref": f"#/$defs/{kind}"} for kind in sorted(KINDS)]},
            "buffers": {"type": "array", "items": buffer},
        },
        "required": ["v", "kind", "body", "buffers"],
        "$defs": dict(sorted(definitions.items())),
    }


def with_specials(node: Any) -> Any:
    """Let every number be one that JSON lacks, too."""
    if isinstance(node, list):
        return [with_specials(item) for item in node]
    if not isinstance(node, dict):
        return node
    if node.get("type") == "number":
        rest = {key: value for key, value in node.items() if key == "default"}
        return {"anyOf": [{"type": "number"}, {"$ref": "#/$defs/NotFinite"}], **rest}
    return {key: with_specials(value) if key != "default" else value for key, value in node.items()}


TYPES = {
    "object": dict, "array": list, "string": str, "boolean": bool, "null": type(None), "integer": int,
    "number": (int, float),
}  # fmt: skip


def valid(value: Any, rule: dict[str, Any], root: dict[str, Any]) -> bool:
    """Check a value against the part of JSON Schema that is used here."""
    if "$ref" in rule:
        return valid(value, root["$defs"][rule["$ref"].rpartition("/")[2]], root)
    if "anyOf" in rule:
        return any(valid(value, option, root) for option in rule["anyOf"])
    if "const" in rule or "enum" in rule:
        return value in rule.get("enum", [rule.get("const")])
    if "type" in rule and (not isinstance(value, TYPES[rule["type"]]) or (rule["type"] != "boolean" and value is True)):
        return False
    if isinstance(value, dict):
        extra = rule.get("additionalProperties", {})
        known = rule.get("properties", {})
        return all(name in value for name in rule.get("required", ())) and all(
            valid(item, known.get(name, extra if isinstance(extra, dict) else {}), root) for name, item in value.items()
        )
    if isinstance(value, list):
        items = rule.get("items", {})
        return all(valid(item, items, root) for item in value) if isinstance(items, dict) else not value
    return True


def test_published_schema_is_todays() -> None:
    now = json.dumps(schema(), indent=1, ensure_ascii=False) + "\n"
    if os.environ.get("FRINGED_WRITE_GOLDEN"):
        PAGE.write_text(now, encoding="utf-8")
    assert PAGE.read_text(encoding="utf-8") == now


@pytest.mark.parametrize("name", examples())
def test_golden_messages_are_valid_by_the_published_schema(name: str) -> None:
    root = json.loads(PAGE.read_text(encoding="utf-8"))
    content, topic, seq = examples()[name]
    header = json.loads(bytes(encode(content, topic, seq)[1]))
    assert valid(header, root, root)
    assert valid(header["body"], root["$defs"][header["kind"]], root)


@pytest.mark.parametrize(
    ("path", "value"),
    [(("v",), 2), (("kind",), "Os"), (("buffers", 0, "dtype"), "|O"), (("body", "frames"), None), (("body", "id"), 5)],
)
def test_schema_finds_what_is_wrong(path: tuple[Any, ...], value: Any) -> None:
    root = json.loads(PAGE.read_text(encoding="utf-8"))
    header = json.loads(bytes(encode(*examples()["frame-set"])[1]))
    node = header
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    right_body = valid(header["body"], root["$defs"]["FrameSet"], root)
    assert not (valid(header, root, root) and right_body)


def test_every_kind_is_published() -> None:
    assert set(json.loads(PAGE.read_text(encoding="utf-8"))["$defs"]) >= set(KINDS)
