"""GenApi: formulas, nodes, and features over a memory; what is not read is refused by name."""

from contextlib import suppress

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fringed.errors import ProtocolError
from fringed.protocols.u3v_features import Features
from fringed.protocols.u3v_formula import evaluate
from fringed.protocols.u3v_genapi import parse_description

XML = """<?xml version="1.0"?>
<RegisterDescription ModelName="T" xmlns="http://www.genicam.org/GenApi/Version_1_1"><Group Comment="all">
<Integer Name="Width"><pValue>WidthReg</pValue><Min>16</Min><pMax>WidthMax</pMax></Integer>
<IntReg Name="WidthReg"><Address>0x10</Address><Length>4</Length><AccessMode>RW</AccessMode></IntReg>
<Integer Name="WidthMax"><Value>100</Value></Integer>
<IntReg Name="Signed"><Address>0x14</Address><Length>2</Length><Sign>Signed</Sign></IntReg>
<IntReg Name="Fixed"><Address>0x14</Address><Length>2</Length><AccessMode>RO</AccessMode></IntReg>
<MaskedIntReg Name="Nibble"><Address>0x18</Address><Length>4</Length><LSB>4</LSB><MSB>7</MSB></MaskedIntReg>
<MaskedIntReg Name="BigBit"><Address>0x18</Address><Length>4</Length><Bit>0</Bit>
  <Endianess>BigEndian</Endianess></MaskedIntReg>
<StructReg Comment="s"><Address>0x1C</Address><Length>4</Length><AccessMode>RW</AccessMode>
  <StructEntry Name="Low"><LSB>0</LSB><MSB>3</MSB></StructEntry>
  <StructEntry Name="Flag"><Bit>8</Bit></StructEntry></StructReg>
<Float Name="Gain"><pValue>GainReg</pValue><Min>0</Min><Max>24.5</Max></Float>
<FloatReg Name="GainReg"><Address>0x20</Address><Length>4</Length></FloatReg>
<Float Name="ExposureTime"><pValue>ExposureTicks</pValue></Float>
<Converter Name="ExposureTicks"><pVariable Name="TICK">Tick</pVariable>
  <FormulaTo>FROM / TICK</FormulaTo><FormulaFrom>TO * TICK</FormulaFrom><pValue>TicksReg</pValue></Converter>
<Float Name="Tick"><Value>0.5</Value></Float>
<IntReg Name="TicksReg"><pAddress>Base</pAddress><Address>0x4</Address><Length>4</Length></IntReg>
<IntReg Name="Nested"><IntSwissKnife Name="NestedAt"><Formula>0x20 + 4</Formula></IntSwissKnife>
  <Length>4</Length></IntReg>
<IntSwissKnife Name="Base"><Formula>4 * 8</Formula></IntSwissKnife>
<Enumeration Name="Mode"><EnumEntry Name="Off"><Value>0</Value></EnumEntry>
  <EnumEntry Name="On"><Value>1</Value></EnumEntry><pValue>Flag</pValue></Enumeration>
<Command Name="Go"><CommandValue>7</CommandValue><pValue>GoReg</pValue></Command>
<IntReg Name="GoReg"><Address>0x28</Address><Length>4</Length><AccessMode>WO</AccessMode></IntReg>
<Integer Name="Loop"><pValue>Loop</pValue></Integer>
<Integer Name="Lost"><pValue>Nowhere</pValue></Integer>
<IntReg Name="Selected"><Address>0x30</Address><pIndex Offset="2">Flag</pIndex><Length>2</Length></IntReg>
<IntReg Name="Stepped"><Address>0x30</Address><pIndex>Flag</pIndex><Length>4</Length></IntReg>
<IntReg Name="Placeless"><Length>4</Length></IntReg>
<SwissKnife Name="Sine"><Formula>SIN(1)</Formula></SwissKnife>
</Group></RegisterDescription>"""


class Memory:
    def __init__(self):
        self.bytes = bytearray(256)

    def read(self, address, count):
        return bytes(self.bytes[address : address + count])

    def write(self, address, data):
        self.bytes[address : address + len(data)] = data


@pytest.fixture
def memory():
    return Memory()


@pytest.fixture
def features(memory):
    return Features(parse_description(XML), memory)


@pytest.mark.parametrize(
    ("formula", "value"),
    [
        ("1 + 2 * 3", 7), ("(1 + 2) * 3", 9), ("-2 - -3", 1), ("7 / 2", 3.5), ("0x10 + 1", 17), ("2 ** 3", 8),
        ("1 = 1 ? 5 : 6", 5), ("0 ? 1 : 0 ? 2 : 3", 3), ("A > 3 && A <= 4", 1), ("(A << 4) | 1", 65), ("~0 & 0xF", 15),
        ("1.5e3", 1500.0), ("10 % 4", 2), ("A <> 4", 0), ("1 ? 2 : 1 / 0", 2), ("6 ^ 3", 5),
    ],
)  # fmt: skip
def test_formulas_have_their_value(formula, value):
    assert evaluate(formula, {"A": 4}.__getitem__) == value


def test_whole_numbers_divide_towards_zero():
    assert evaluate("-7 / 2", {}.__getitem__, integer=True) == -3


@pytest.mark.parametrize(
    ("formula", "told"),
    [
        ("", "number should"), ("1 +", "number should"), ("(1", "missing"), ("1 1", "too much"),
        ("SIN(1)", "function SIN"),
        ("1 / 0", "no value"), ("2 ** 65", "more than 64"), ("1 << 64", "0 to 63"), ("1 $ 2", "cannot be read"),
        ("(" * 60 + "1", "brackets"), ("0 - 1 ? (0-1) ** 0.5 : 1", "real"), ("1" * 5000, "characters"),
    ],
)  # fmt: skip
def test_formulas_that_cannot_be_computed_are_named(formula, told):
    with pytest.raises(ProtocolError, match=told):
        evaluate(formula, {}.__getitem__)


@settings(max_examples=300)
@given(st.text("0123456789.xAe+-*/%&|^~<>=?:() ", max_size=30))
def test_any_formula_has_a_value_or_a_protocol_error(formula):
    with suppress(ProtocolError):
        evaluate(formula, lambda _: 3)


def test_numbers_are_written_and_read_back(features, memory):
    features.set("Width", 64)
    assert memory.read(0x10, 4) == b"\x40\0\0\0" and features.whole("Width") == 64
    features.set("Signed", -2)
    assert memory.read(0x14, 2) == b"\xfe\xff" and features.number("Signed") == -2
    features.set("Gain", 6.5)
    assert features.number("Gain") == 6.5


def test_masked_registers_keep_their_other_bits(features, memory):
    memory.write(0x18, b"\xff\0\0\0")
    features.set("Nibble", 5)
    assert memory.read(0x18, 4) == b"\x5f\0\0\0" and features.number("Nibble") == 5
    features.set("Low", 3)
    features.set("Flag", 1)
    assert memory.read(0x1C, 4) == b"\x03\x01\0\0"


def test_big_endian_bits_count_from_the_other_end(features, memory):
    features.set("BigBit", 1)
    assert memory.read(0x18, 4) == b"\x80\0\0\0"


def test_converters_and_addresses_are_computed(features, memory):
    features.set("ExposureTime", 100)
    assert memory.read(0x24, 4) == (200).to_bytes(4, "little")
    assert features.number("ExposureTime") == 100.0
    assert features.number("Nested") == 200


def test_an_index_moves_a_register(features, memory):
    memory.write(0x30, bytes(range(1, 9)))
    assert (features.number("Selected"), features.number("Stepped")) == (0x0201, 0x04030201)
    features.set("Flag", 1)
    assert (features.number("Selected"), features.number("Stepped")) == (0x0403, 0x08070605)


def test_enumerations_go_by_name_and_commands_by_their_value(features, memory):
    features.set("Mode", "On")
    assert features.choice("Mode") == "On" and features.choices("Mode") == ("Off", "On")
    features.execute("Go")
    assert memory.read(0x28, 4) == b"\x07\0\0\0"


def test_local_values_are_remembered(features):
    features.set("WidthMax", 50)
    assert features.limits("Width") == (16, 50)
    assert features.has("Width", "Mode") and not features.has("Width", "Height")


@pytest.mark.parametrize(
    ("act", "told"),
    [
        (lambda f: f.set("Width", 101), "16 to 100"),
        (lambda f: f.set("Mode", "Maybe"), "Off, On"),
        (lambda f: f.set("Fixed", 1), "only be read"),
        (lambda f: f.set("Nibble", 16), "from 0 to 15"),
        (lambda f: f.set("Signed", 40000), "-32768 to 32767"),
        (lambda f: f.set("GainReg", 1e39), "cannot hold"),
        (lambda f: f.set("GainReg", float("nan")), "cannot hold"),
        (lambda f: f.set("Base", 1), "computed"),
        (lambda f: f.execute("Width"), "a command is expected"),
        (lambda f: f.number("Loop"), "refers to itself"),
        (lambda f: f.number("Lost"), "no Nowhere"),
        (lambda f: f.number("Placeless"), "not read here"),
        (lambda f: f.number("Sine"), "function SIN"),
        (lambda f: f.number("Colour"), "no Colour.*viewer"),
    ],
)
def test_what_cannot_be_done_is_named(features, act, told):
    with pytest.raises(ProtocolError, match=told):
        act(features)


def test_an_entry_that_the_description_does_not_name_is_told(memory):
    xml = XML.replace("<Value>1</Value></EnumEntry>", "<Value>9</Value></EnumEntry>")
    features = Features(parse_description(xml), memory)
    memory.write(0x1D, b"\x01")
    with pytest.raises(ProtocolError, match="Mode is 1"):
        features.choice("Mode")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "no XML"), ("<a>", "no XML"), ("<a/>", "RegisterDescription"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "entities"),
        (XML.replace("<Value>1</Value></EnumEntry>", "<Value>one</Value></EnumEntry>"), "'one'"),
    ],
)  # fmt: skip
def test_a_text_that_is_no_description_is_named(text, told):
    with pytest.raises(ProtocolError, match=told):
        parse_description(text)


@settings(max_examples=150, deadline=None)
@given(st.integers(150, len(XML) - 1), st.text(max_size=4))
def test_damaged_descriptions_raise_only_protocol_errors(at, damage):
    with suppress(ProtocolError):
        nodes = parse_description(XML[:at] + damage + XML[at + len(damage) :])
        features = Features(nodes, Memory())
        for name in nodes:
            with suppress(ProtocolError):
                features.number(name)
            with suppress(ProtocolError):
                features.set(name, 1)
