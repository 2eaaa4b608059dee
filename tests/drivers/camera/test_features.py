"""Features by name through GenApi, over a description and register memory of this test's own."""

from __future__ import annotations

import struct
from collections.abc import Callable
from contextlib import suppress

import pytest
from hypothesis import given

from drivers.api import DeviceGone, DeviceRefused
from drivers.camera.features import Features
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


class Registers:
    """64 KiB of registers of a camera that may be unplugged."""

    def __init__(self) -> None:
        self.memory = bytearray(65536)
        self.plugged = True
        self.holds: dict[int, bytes] = {}
        """What a register holds whatever is written to it."""

    def read(self, address: int, count: int) -> bytes:
        if not self.plugged:
            raise DeviceGone("camera.left", "unplugged", "Re-plug it")
        return bytes(self.memory[address : address + count])

    def write(self, address: int, data: bytes) -> None:
        self.read(address, len(data))
        self.memory[address : address + len(data)] = self.holds.get(address, data)


def described_by(xml: str) -> tuple[Registers, Features]:
    memory = Registers()
    return memory, Features("camera.left", xml, memory)


def test_a_number_is_written_where_the_description_says_and_what_the_camera_holds_is_returned() -> None:
    """Even beyond its own range: the description lets a reader keep what was written, and check what is read."""
    memory, features = described_by(XML)
    assert features.set_number("Width", 640.0) == 640
    assert memory.memory[0x1000:0x1004] == struct.pack("<I", 640)
    for held in (632, 1608):
        memory.holds = {0x1000: struct.pack("<I", held)}
        assert features.set_number("Width", 640) == held
    assert features.set_number("ExposureTime", 1000.1) == struct.unpack("<f", struct.pack("<f", 1000.1))[0] != 1000.1
    assert memory.memory[0x100C:0x1010] == struct.pack("<f", 1000.1)
    features.execute("AcquisitionStart")
    assert memory.memory[0x1008] == 1
    memory.plugged = False
    with pytest.raises(DeviceGone):
        features.set_number("Width", 320)


def test_features_and_choices_are_those_that_are_there_now() -> None:
    _, features = described_by(XML)
    found = {name: (features.has(name), features.writable(name)) for name in ("Width", "Fixed", "Absent", "Gain")}
    assert found == {"Width": (True, True), "Fixed": (True, False), "Absent": (False, False), "Gain": (False, False)}
    assert features.choices("TriggerMode") == ("Off", "On")
    assert features.choice("TriggerMode") == "Off"
    features.choose("TriggerMode", "On")
    assert features.choice("TriggerMode") == "On"


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        *(
            (lambda f, bad=bad: f.set_number("Width", bad), rf"Width: {bad} refused, .*16\.\.1600 in steps of 16")
            for bad in (8, 1601, 17)
        ),
        (lambda f: f.set_number("ExposureTime", 1e6), r"ExposureTime: 1e\+06 refused, allowed 10\.\.16000 \("),
        (lambda f: f.choose("TriggerMode", "Sometimes"), "Sometimes refused, allowed: Off On"),
        (lambda f: f.number("Gain"), "no feature Gain"),
        (lambda f: f.number("Locked"), "Locked: cannot be read"),
        (lambda f: f.set_number("Locked", 1), "Locked: 1 refused, allowed range unknown"),
        (lambda f: f.choice("LockedMode"), "LockedMode: cannot be read"),
        (lambda f: f.choose("LockedMode", "On"), "LockedMode: On refused, allowed: "),
        (lambda f: f.execute("LockedStart"), "LockedStart: cannot be executed"),
        (lambda f: f.number("TriggerMode"), "TriggerMode is an IEnumeration, not IInteger or IFloat"),
        (lambda f: f.set_number("AcquisitionStart", 1), "AcquisitionStart is an ICommand, not IInteger or IFloat"),
        (lambda f: f.choices("Width"), "Width is an IInteger, not IEnumeration"),
        (lambda f: f.choose("ExposureTime", "On"), "ExposureTime is an IFloat, not IEnumeration"),
        (lambda f: f.execute("Width"), "Width is an IInteger, not ICommand"),
    ],
)
def test_what_cannot_be_done_with_a_feature_is_refused_by_name_and_range(
    ask: Callable[[Features], object], said: str
) -> None:
    memory, features = described_by(XML)
    with pytest.raises(DeviceRefused, match=f"^camera.left: .*{said}"):
        ask(features)
    assert not any(memory.memory)


@pytest.mark.parametrize(
    ("xml", "said"),
    [
        *((text, "description") for text in ("", "<a/>", XML[:900], "\0")),
        (XML.replace("<Port ", "<Group>" * 100_000 + "</Group>" * 100_000 + "<Port "), "nested deeper than 32"),
        (XML.replace("<Port ", "<Group>" * 31 + "</Group>" * 31 + "<Port "), "parsing XML stream"),  # GenApi's words
        (XML.replace("<RegisterDescription", "<!DOCTYPE R><RegisterDescription", 1), "a document type is declared"),
        (XML.replace("<pPort>Device<", "<pPort>Width<", 1), "cannot be loaded .*port"),
        (XML.replace("<pFeature>Width<", "<pFeature>Device<", 1), "cannot be loaded .*port"),
    ],
    ids=range(9),
)
def test_a_description_that_is_none_or_beyond_any_cameras_is_refused(xml: str, said: str) -> None:
    """A hundred thousand nested elements end the process from below Python, where nothing can be caught."""
    with pytest.raises(DeviceRefused, match=said):
        described_by(xml)


TAGS = (
    "<pValue>Width</pValue>", "<pAddress>Width</pAddress>", "<Length>-1</Length>", "<Length>999999999</Length>", "&e;", "<!--", "]]>",
    "<Formula>1/0</Formula>", "<Address>0xFFFFFFFFFFFFFFFF</Address>", "<pIsAvailable>TriggerMode</pIsAvailable>", "Name='Width'",
    "<pSelected>Width</pSelected>", "<Inc>0</Inc>", "<Min>nan</Min>", "<pInvalidator>Width</pInvalidator>", "<pFeature>Root</pFeature>",
)  # fmt: skip
NAMES = ("Width", "TriggerMode", "ExposureTime", "AcquisitionStart", "Root", "WidthReg", "Device", "Nothing")


@given(damaged([XML.encode()], [tag.encode() for tag in TAGS]).map(lambda data: data.decode("utf-8", "replace")))
def test_a_description_that_says_nonsense_is_refused_or_used_and_kills_nobody(xml: str) -> None:
    with suppress(DeviceRefused, DeviceGone):
        _, features = described_by(xml)
        for name in filter(features.has, NAMES):
            features.writable(name)
            uses = (features.number, features.choice, features.choices, lambda n: features.set_number(n, 32.0),
                    lambda n: features.choose(n, "On"), features.execute)  # fmt: skip
            for use in uses:
                with suppress(DeviceRefused):
                    use(name)
