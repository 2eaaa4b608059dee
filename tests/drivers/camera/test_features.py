"""Features by name through GenApi, over a description and register memory of this test's own."""

from __future__ import annotations

import re
import struct
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.api import DeviceGone, DeviceRefused
from drivers.camera.control import ControlChannel
from drivers.camera.features import Features
from drivers.camera.usb import Unplugged
from tests.drivers.clock import SteppedClock
from tests.support.damage import damaged

REGISTERS = "".join(
    f"<IntReg Name='{name}Reg'><Address>{address}</Address><Length>4</Length><AccessMode>{mode}</AccessMode>"
    "<pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>LittleEndian</Endianess></IntReg>"
    for name, address, mode in (("Width", 0x1000, "RW"), ("Mode", 0x1004, "RW"), ("Start", 0x1008, "WO"))
)
XML = f"""<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="T" VendorName="V" StandardNameSpace="None" SchemaMajorVersion="1"
 SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0"
 ProductGuid="1F3C6A72-7842-4edd-9130-E2E90A2058BA" VersionGuid="7C9F2E1A-6A5B-4e8c-8A61-5E7A0C6B9D10"
 xmlns="http://www.genicam.org/GenApi/Version_1_1">
<Category Name="Root"><pFeature>Width</pFeature></Category>
<Integer Name="Width"><pValue>WidthReg</pValue><Min>16</Min><Max>1600</Max><Inc>16</Inc></Integer>
<Enumeration Name="TriggerMode"><EnumEntry Name="Off"><Value>0</Value></EnumEntry>
<EnumEntry Name="On"><Value>1</Value></EnumEntry>
<EnumEntry Name="Later"><pIsAvailable>No</pIsAvailable><Value>2</Value></EnumEntry>
<pValue>ModeReg</pValue></Enumeration>
<Float Name="ExposureTime"><pValue>ExposureReg</pValue><Min>10</Min><Max>16000</Max></Float>
<FloatReg Name="ExposureReg"><Address>0x100c</Address><Length>4</Length><AccessMode>RW</AccessMode>
<pPort>Device</pPort><Endianess>LittleEndian</Endianess></FloatReg>
<Command Name="AcquisitionStart"><pValue>StartReg</pValue><CommandValue>1</CommandValue></Command>
<Integer Name="Fixed"><pIsLocked>Yes</pIsLocked><Value>7</Value></Integer>
<Integer Name="Absent"><pIsImplemented>No</pIsImplemented><pValue>WidthReg</pValue></Integer>
<Integer Name="Yes"><Value>1</Value></Integer><Integer Name="No"><Value>0</Value></Integer>
<Integer Name="Locked"><pIsAvailable>No</pIsAvailable><pValue>WidthReg</pValue></Integer>
<Enumeration Name="LockedMode"><pIsAvailable>No</pIsAvailable><EnumEntry Name="On"><Value>1</Value></EnumEntry>
<pValue>ModeReg</pValue></Enumeration>
<Command Name="LockedStart"><pIsAvailable>No</pIsAvailable><pValue>StartReg</pValue>
<CommandValue>1</CommandValue></Command>
{REGISTERS}<Port Name="Device"/></RegisterDescription>"""


class RegisterMemory:
    """A control pipe in front of 64 KiB of registers."""

    def __init__(self) -> None:
        self.memory = bytearray(65536)
        self.plugged = True
        self.holds: dict[int, bytes] = {}
        """What a register holds whatever is written to it."""
        self._answer = b""

    def write(self, data: bytes, timeout_s: float) -> None:
        if not self.plugged:
            raise Unplugged("gone")
        _, _, command, size, request_id = struct.unpack_from("<IHHHH", data)
        (address,) = struct.unpack_from("<Q", data, 12)
        if command == 0x0800:
            (count,) = struct.unpack_from("<H", data, 22)
            payload = bytes(self.memory[address : address + count])
        else:
            self.memory[address : address + size - 8] = self.holds.get(address, data[20:])
            payload = struct.pack("<HH", 0, size - 8)
        self._answer = struct.pack("<4sHHHH", b"U3VC", 0, command + 1, len(payload), request_id) + payload

    def read(self, size: int, timeout_s: float) -> bytes:
        return self._answer

    def clear_halt(self) -> None: ...


@pytest.fixture
def device() -> Any:
    memory = RegisterMemory()
    return memory, Features("camera.left", XML, ControlChannel("camera.left", memory, SteppedClock()))


def test_a_number_is_written_where_the_description_says(device: Any) -> None:
    memory, features = device
    assert features.set_number("Width", 640) == 640
    assert memory.memory[0x1000:0x1004] == struct.pack("<I", 640)


def test_what_is_returned_is_what_the_camera_holds(device: Any) -> None:
    _, features = device
    got = features.set_number("ExposureTime", 1000.1)
    assert got == struct.unpack("<f", struct.pack("<f", 1000.1))[0] != 1000.1


@pytest.mark.parametrize("bad", [8, 1601, 17])
def test_a_value_out_of_range_is_refused_with_the_range(device: Any, bad: int) -> None:
    memory, features = device
    with pytest.raises(DeviceRefused, match=rf"Width: {bad} refused, allowed 16\.\.1600 in steps of 16"):
        features.set_number("Width", bad)
    assert memory.memory[0x1000:0x1004] == b"\0\0\0\0"


def test_an_unknown_choice_is_refused_with_the_choices(device: Any) -> None:
    _, features = device
    features.choose("TriggerMode", "On")
    assert features.choice("TriggerMode") == "On"
    with pytest.raises(DeviceRefused, match="Sometimes refused, allowed: Off On"):
        features.choose("TriggerMode", "Sometimes")


def test_a_missing_feature_is_named(device: Any) -> None:
    _, features = device
    assert not features.has("Gain")
    with pytest.raises(DeviceRefused, match="no feature Gain"):
        features.number("Gain")


def test_a_command_reaches_its_register(device: Any) -> None:
    memory, features = device
    features.execute("AcquisitionStart")
    assert memory.memory[0x1008] == 1


def test_an_unplugged_camera_is_gone_not_a_bad_value(device: Any) -> None:
    memory, features = device
    memory.plugged = False
    with pytest.raises(DeviceGone):
        features.set_number("Width", 320)


@pytest.mark.parametrize("text", ["", "<a/>", XML[:900], "\0"])
def test_a_description_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(DeviceRefused, match="description"):
        Features("camera.left", text, ControlChannel("camera.left", RegisterMemory(), SteppedClock()))


def nested(depth: int) -> str:
    return XML.replace("<Port ", "<Group>" * depth + "</Group>" * depth + "<Port ")


def test_a_camera_that_rounds_what_it_is_told_is_asked_what_it_holds_even_beyond_its_own_range(device: Any) -> None:
    """The description lets a reader keep what was written, and check what is read."""
    memory, features = device
    for held in (632, 1608):
        memory.holds = {0x1000: struct.pack("<I", held)}
        assert features.set_number("Width", 640) == held


def test_a_number_that_has_fractions_or_not_is_written_as_its_register_takes_it(device: Any) -> None:
    memory, features = device
    assert features.set_number("Width", 320.0) == 320
    assert features.set_number("ExposureTime", 500) == 500.0
    assert struct.unpack("<f", memory.memory[0x100C:0x1010]) == (500.0,)
    with pytest.raises(DeviceRefused, match=r"ExposureTime: 1e\+06 refused, allowed 10\.\.16000 \(") as caught:
        features.set_number("ExposureTime", 1e6)
    assert caught.value.device == "camera.left"
    assert "in steps" not in caught.value.message


def test_what_a_camera_has_and_what_may_be_written_are_two_things(device: Any) -> None:
    _, features = device
    assert (features.has("Width"), features.writable("Width")) == (True, True)
    assert (features.has("Fixed"), features.writable("Fixed")) == (True, False)
    assert (features.has("Absent"), features.writable("Absent")) == (False, False)
    assert (features.has("Gain"), features.writable("Gain")) == (False, False)


def test_choices_come_in_the_order_of_the_description_without_those_that_are_not_there_now(device: Any) -> None:
    _, features = device
    assert features.choices("TriggerMode") == ("Off", "On")
    assert features.choice("TriggerMode") == "Off"


REFUSED_BY = {
    "number": lambda features: features.number("Locked"),
    "set": lambda features: features.set_number("Locked", 1),
    "choice": lambda features: features.choice("LockedMode"),
    "choose": lambda features: features.choose("LockedMode", "On"),
    "execute": lambda features: features.execute("LockedStart"),
}


@pytest.mark.parametrize(
    ("way", "said"),
    [
        ("number", "Locked: cannot be read"),
        ("set", "Locked: 1 refused, allowed range unknown"),
        ("choice", "LockedMode: cannot be read"),
        ("choose", "LockedMode: On refused, allowed: "),
        ("execute", "LockedStart: cannot be executed"),
    ],
)
def test_a_feature_that_is_locked_is_refused_by_name(device: Any, way: str, said: str) -> None:
    _, features = device
    with pytest.raises(DeviceRefused, match=said) as caught:
        REFUSED_BY[way](features)
    assert caught.value.device == "camera.left"
    assert "camera's manual" in caught.value.remedy


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda f: f.number("TriggerMode"), "TriggerMode is an IEnumeration, not IInteger or IFloat"),
        (lambda f: f.set_number("AcquisitionStart", 1), "AcquisitionStart is an ICommand, not IInteger or IFloat"),
        (lambda f: f.choices("Width"), "Width is an IInteger, not IEnumeration"),
        (lambda f: f.choose("ExposureTime", "On"), "ExposureTime is an IFloat, not IEnumeration"),
        (lambda f: f.execute("Width"), "Width is an IInteger, not ICommand"),
    ],
)
def test_a_standard_name_for_something_else_is_refused(device: Any, ask: Any, said: str) -> None:
    _, features = device
    with pytest.raises(DeviceRefused, match=said):
        ask(features)


ENTITIES = "".join(f"<!ENTITY e{n} '{f'&e{n - 1};' * 10}'>" for n in range(1, 12))
MANY = " ".join(f"b{n}='0'" for n in range(65))
BOMB = XML.replace(
    "<RegisterDescription", f"<!DOCTYPE R [<!ENTITY e0 'Width'>{ENTITIES}]><RegisterDescription", 1
).replace("<pFeature>Width</pFeature>", "<pFeature>&e11;</pFeature>")
FILE = XML.replace(
    "<RegisterDescription", "<!DOCTYPE R [<!ENTITY f SYSTEM 'file:///etc/passwd'>]><RegisterDescription", 1
).replace("<pFeature>Width</pFeature>", "<pFeature>&f;</pFeature>")


@pytest.mark.parametrize(
    ("xml", "words"),
    [
        (nested(100_000), "nested deeper than 32"),
        (nested(32), "nested deeper than 32"),
        (XML.replace("<Port ", "<a/>" * 400_001 + "<Port "), "more than 400000 elements"),
        (XML.replace("<Port ", f"<a {MANY}/><Port "), "more than 64 attributes"),
        (BOMB, "a document type is declared"),
        (FILE, "a document type is declared"),
    ],
    ids=["deep", "just too deep", "many", "attributes", "entities", "a file of this machine"],
)
def test_a_description_beyond_any_cameras_never_reaches_the_native_parser(xml: str, words: str) -> None:
    """A hundred thousand nested elements end the process from below Python, where nothing can be caught."""
    with pytest.raises(DeviceRefused, match=words):
        Features("camera.left", xml, ControlChannel("camera.left", RegisterMemory(), SteppedClock()))


def test_a_description_within_the_limits_goes_on_to_the_native_parser() -> None:
    with pytest.raises(DeviceRefused, match="parsing XML stream"):  # GenApi's own words: it knows no such nesting
        Features("camera.left", nested(31), ControlChannel("camera.left", RegisterMemory(), SteppedClock()))


TAGS = (
    "<pValue>Width</pValue>", "<pMin>Width</pMin>", "<pAddress>Width</pAddress>", "<Length>0</Length>", "<Length>-1</Length>", "&e;", "&amp;",
    "<Length>999999999</Length>", "<Formula>1/0</Formula>", "<Address>0xFFFFFFFFFFFFFFFF</Address>", "<pIsAvailable>TriggerMode</pIsAvailable>",
    "<pSelected>Width</pSelected>", "<Inc>0</Inc>", "<Min>nan</Min>", "<!--", "]]>", "Name='Width'", "<pInvalidator>Width</pInvalidator>",
    "<IntSwissKnife Name='K'><pVariable Name='W'>Width</pVariable><Formula>W/0</Formula></IntSwissKnife>", "<pFeature>Root</pFeature>",
)  # fmt: skip
NAMES = ("Width", "TriggerMode", "ExposureTime", "AcquisitionStart", "Root", "WidthReg", "Device", "Nothing")
OTHERS = (
    *NAMES,
    "0",
    "1",
    "8",
    "0x1000",
    "-1",
    "nan",
    "0xFFFFFFFFFFFFFFFF",
    "99999999",
    "BigEndian",
    "RO",
    "NI",
    "",
    "1/0",
)


@st.composite
def described_otherwise(draw: st.DrawFn) -> str:
    """A description that is well-formed and says something else here and there."""
    xml = XML
    for _ in range(draw(st.integers(1, 3))):
        begin, end = draw(
            st.sampled_from([found.span(1) for found in re.finditer(r"(?:>|Name=[\"'])([^<>\"']+)[<\"']", xml)])
        )
        xml = xml[:begin] + draw(st.sampled_from(OTHERS)) + xml[end:]
    return xml.replace("<Port", draw(st.sampled_from(("", "", "", *TAGS))) + "<Port")


@given(
    described_otherwise()
    | damaged([XML.encode()], [tag.encode() for tag in TAGS]).map(lambda data: data.decode("utf-8", "replace"))
)
def test_a_description_that_says_nonsense_is_refused_or_used_and_kills_nobody(xml: str) -> None:
    with suppress(DeviceRefused, DeviceGone):
        features = Features("camera.left", xml, ControlChannel("camera.left", RegisterMemory(), SteppedClock()))
        for name in filter(features.has, NAMES):
            features.writable(name)
            uses = (features.number, features.choice, features.choices, lambda n: features.set_number(n, 32.0),
                    lambda n: features.choose(n, "On"), features.execute)  # fmt: skip
            for use in uses:
                with suppress(DeviceRefused):
                    use(name)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<pPort>Device<", "<pPort>Width<", "its description cannot be loaded .*port"),
        ("<pFeature>Width<", "<pFeature>Device<", "its description cannot be loaded .*port"),
        ('encoding="utf-8"', 'encoding="inf-8"', "not well-formed"),
    ],
)
def test_a_description_that_kills_genapi_is_refused(old: str, new: str, said: str) -> None:
    with pytest.raises(DeviceRefused, match=said):
        Features(
            "camera.left", XML.replace(old, new, 1), ControlChannel("camera.left", RegisterMemory(), SteppedClock())
        )
