"""The library's list, its errors and a device's memory: what each call asks for, and what each failure means."""

from __future__ import annotations

import ctypes
from functools import partial
from typing import Any

import pytest

from drivers.api import DeviceError, DeviceGone, DeviceRefused
from drivers.aravis import library
from drivers.aravis.device import AravisDevice
from drivers.aravis.library import Aravis, AravisError, BufferCode, DeviceCode, ListedCamera
from drivers.camera.control import ControlRefused
from tests.drivers.aravis.foreign import ForeignLibrary


def opened(foreign: ForeignLibrary, protocol: str = "USB3Vision", **more: Any) -> AravisDevice:
    foreign.add(protocol, **more)
    aravis = library.library("camera.left")
    return AravisDevice("camera.left", aravis, aravis.cameras()[-1])


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (OSError("no such file"), r"cannot be loaded \(no such file\). Install it: apt install libaravis-0.8-0"),
        (AttributeError("no arv_x"), r"is too old \(no arv_x\). Install 0.8.22 or later"),
    ],
)
def test_without_the_library_or_with_an_old_one_the_remedy_is_said(
    error: Exception, said: str, foreign: ForeignLibrary, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_file: str) -> None:
        raise error

    monkeypatch.setattr(ctypes, "CDLL", refuse)
    with pytest.raises(DeviceRefused, match=f"camera.left: the library Aravis {said}"):
        library.library("camera.left")


def test_cameras_are_looked_for_anew_each_time_and_each_is_released_once(foreign: ForeignLibrary) -> None:
    aravis = library.library("camera.left")
    assert (aravis.version, foreign.enabled) == ("0.8.26", [b"Fake"])
    assert aravis.cameras() == ()
    foreign.add("USB3Vision", id="Reef-1", serial=" 0001 ", address=None)
    assert aravis.cameras() == (ListedCamera("Reef-1", "0001", "USB3Vision", ""),), "a word that is missing is empty"
    assert foreign.looked == 2
    with AravisDevice("camera.left", aravis, aravis.cameras()[0]) as device:
        assert list(foreign.open) == [device.handle]
        device.close()
        assert not foreign.open
        with pytest.raises(DeviceGone, match=r"camera.left: closed"):
            device.read(0, 4)


def test_a_failed_call_tells_message_and_code_and_frees_its_error(foreign: ForeignLibrary) -> None:
    aravis: Aravis = library.library("camera.left")
    for message, said in ((b"broken", "broken"), (None, "")):
        with pytest.raises(AravisError) as caught:
            aravis.checked(partial(foreign.fail, code=5, message=message))
        assert (str(caught.value), caught.value.code) == (said, 5)
    with pytest.raises(AravisError, match="the library gave no reason") as caught:
        aravis.checked(lambda error: None)
    assert caught.value.code == 6
    assert aravis.checked(lambda error: 12) == 12
    assert foreign.freed_errors == 2


def test_codes_are_those_of_the_librarys_headers() -> None:
    """``arvdevice.h`` and ``arvbuffer.h``, counted from 0 and from -1; from 12 on it is what a camera answered."""
    device = {"NOT_CONNECTED": 2, "PROTOCOL_ERROR": 3, "TRANSFER_ERROR": 4, "TIMEOUT": 5, "NOT_FOUND": 6}
    device |= {"NOT_CONTROLLER": 10, "NOT_IMPLEMENTED": 12, "BUSY": 18}
    assert {one.name: one.value for one in DeviceCode} == device
    buffer = "UNKNOWN SUCCESS CLEARED TIMEOUT MISSING_PACKETS WRONG_PACKET_ID SIZE_MISMATCH FILLING ABORTED"
    assert {one.name: one.value for one in BufferCode} == {name: k for k, name in enumerate(buffer.split(), -1)}


@pytest.mark.parametrize(
    ("code", "error"), [(2, DeviceGone), (6, DeviceGone), (3, DeviceRefused), (5, DeviceRefused), (10, DeviceRefused)]
)
def test_what_is_not_there_is_gone_and_what_does_not_open_is_refused(
    foreign: ForeignLibrary, code: int, error: type[Exception]
) -> None:
    with pytest.raises(error, match=r"could not be opened \(busy\)"):
        opened(foreign, opens=(code, "busy"))


@pytest.mark.parametrize(
    ("address", "count", "asked"),
    [
        (0x4B, 5, [(0x48, 8)]),
        (0x4B, 6, [(0x48, 12)]),
        (0x100, 512, [(0x100, 512)]),
        (0x100, 513, [(0x100, 512), (0x300, 4)]),
        (0x102, 1500, [(0x100, 512), (0x300, 512), (0x500, 480)]),
    ],
)
def test_a_piece_is_read_in_whole_words_of_at_most_512_bytes(
    foreign: ForeignLibrary, address: int, count: int, asked: list[tuple[int, int]]
) -> None:
    device = opened(foreign)
    there = foreign.devices[0]
    there.camera.set(0, bytes(k * 7 % 251 for k in range(4096)))
    assert device.read(address, count) == bytes(k * 7 % 251 for k in range(address, address + count))
    assert there.asked == [("read", *one) for one in asked]


def test_what_is_long_is_written_in_pieces_and_registers_have_64_bits(foreign: ForeignLibrary) -> None:
    device = opened(foreign)
    data = bytes(k * 7 % 251 for k in range(1030))
    device.write(0x7_0000, data)
    there = foreign.devices[0]
    assert there.camera.get(0x7_0000, 1030) == data
    assert there.asked == [("write", 0x7_0000, 512), ("write", 0x7_0200, 512), ("write", 0x7_0400, 6)]
    assert device.read((1 << 64) - 4, 4) == bytes(4)
    device.write(0x0, bytes(4))
    for address in ((1 << 64) - 3, 1 << 64, -4):
        with pytest.raises(DeviceRefused, match="outside 64 bits"):
            device.write(address, bytes(4))


@pytest.mark.parametrize("code", [2, 3, 4, 5, 10, 11, 12, 18, 19])
def test_an_answer_is_a_refusal_and_no_answer_a_loss(foreign: ForeignLibrary, code: int) -> None:
    device = opened(foreign)
    foreign.devices[0].refusing[0x40] = code
    kind: type[DeviceError] = DeviceGone
    said = r"a read of 4 bytes at 0x40 \(no luck\)"
    if code in (3, 12, 18):
        kind, said = ControlRefused, r"refused the read of 4 bytes at 0x40: no luck"
    with pytest.raises(kind, match=said) as caught:
        device.read(0x40, 4)
    assert getattr(caught.value, "status", code) == code


def test_a_description_is_text_of_a_possible_length(foreign: ForeignLibrary, monkeypatch: pytest.MonkeyPatch) -> None:
    assert opened(foreign, xml=b"\xef\xbb\xbf<a>\xc2\xb5</a>\0\0").description() == "<a>µ</a>"
    with pytest.raises(DeviceRefused, match="no description"):
        opened(foreign, xml=b"", claimed_bytes=9).description()
    monkeypatch.setattr(ctypes, "string_at", lambda text, size: b"x" * size)
    for claimed_bytes in (1, 1 << 24):
        assert len(opened(foreign, claimed_bytes=claimed_bytes).description()) == claimed_bytes
    for claimed_bytes in (0, (1 << 24) + 1):
        with pytest.raises(DeviceRefused, match="no description"):
            opened(foreign, claimed_bytes=claimed_bytes).description()
