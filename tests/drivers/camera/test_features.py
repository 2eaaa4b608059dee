"""Features by name through GenApi, over a description and register memory of this test's own."""

from __future__ import annotations

import struct
from typing import Any

import pytest

from drivers.api import DeviceGone, DeviceRefused
from drivers.camera.control import ControlChannel
from drivers.camera.features import Features
from drivers.camera.usb import Unplugged
from tests.drivers.clock import SteppedClock

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
<EnumEntry Name="On"><Value>1</Value></EnumEntry><pValue>ModeReg</pValue></Enumeration>
<Float Name="ExposureTime"><pValue>ExposureReg</pValue><Min>10</Min><Max>16000</Max></Float>
<FloatReg Name="ExposureReg"><Address>0x100c</Address><Length>4</Length><AccessMode>RW</AccessMode>
<pPort>Device</pPort><Endianess>LittleEndian</Endianess></FloatReg>
<Command Name="AcquisitionStart"><pValue>StartReg</pValue><CommandValue>1</CommandValue></Command>
{REGISTERS}<Port Name="Device"/></RegisterDescription>"""


class RegisterMemory:
    """A control pipe in front of 64 KiB of registers."""

    def __init__(self) -> None:
        self.memory = bytearray(65536)
        self.plugged = True
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
            self.memory[address : address + size - 8] = data[20:]
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
