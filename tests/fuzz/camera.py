"""What a camera may send: answers, registers, its description, leaders, pixels and trailers."""

from __future__ import annotations

import hashlib
import io
import re
import struct
import zipfile
from contextlib import suppress
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from drivers.api import DeviceGone, DeviceRefused, Frame, FrameStatus
from drivers.camera.bootstrap import (
    ManifestEntry,
    parse_identification,
    parse_manifest_entry,
    parse_stream_needs,
    parse_technology,
)
from drivers.camera.control import ATTEMPTS, PENDING_LIMIT_S, RESPONSE_TIME_S, ControlChannel
from drivers.camera.description import MAX_FILE_SIZE, BadDescription, check_sha1, read_description, unpack
from drivers.camera.descriptors import MalformedDescriptor, find_device_info, parse_device_info, parse_string
from drivers.camera.features import Features
from drivers.camera.gencp import MalformedPacket, parse_answer, parse_pending, parse_written, status_name
from drivers.camera.packets import MalformedStreamPacket, parse_leader, parse_trailer
from drivers.camera.pixels import FORMATS
from drivers.camera.stream import StreamGeometry, StreamReader
from drivers.camera.usb import TransferError, TransferOverflow, TransferStalled, Unplugged
from tests.drivers.camera.test_control import Memory
from tests.drivers.camera.test_features import XML, RegisterMemory
from tests.drivers.camera.test_stream import HEIGHT, PACKET, PIXELS, WIDTH, Pipe, leader, trailer
from tests.drivers.clock import SteppedClock
from tests.fuzz.damage import WORDS, damaged
from tests.fuzz.target import Target

NAME = "camera.left"

# ----------------------------------------------------------------------------------------------------- control

READ = struct.pack("<4sHHHH", b"U3VC", 0, 0x0801, 64, 1) + bytes(range(64))
WRITTEN = struct.pack("<4sHHHHHH", b"U3VC", 0, 0x0803, 4, 1, 0, 8)
PENDING = struct.pack("<4sHHHHHH", b"U3VC", 0, 0x0805, 4, 1, 0, 300)
REFUSED = struct.pack("<4sHHHH", b"U3VC", 0x8006, 0x0801, 0, 1)
ANSWERS = (READ, WRITTEN, PENDING, REFUSED)


def _answer(chance: Random) -> bytes:
    return damaged(chance, chance.choice(ANSWERS), ANSWERS)


def _read_answer(data: bytes, _: Path) -> None:
    answer = parse_answer(data)
    assert len(answer.payload) == int.from_bytes(data[8:10], "little")
    assert status_name(answer.status)
    parse_written(answer.payload)
    assert 0 <= parse_pending(answer.payload) < 65536


def _conversation(chance: Random) -> tuple[int, list[bytes | str]]:
    """How many bytes are asked for (negative: written), and what the device does, one after the other."""
    acts: list[bytes | str] = []
    for _ in range(chance.randrange(0, 12)):
        match chance.randrange(10):
            case 0:
                acts.append(chance.choice(("stall", "overflow", "error", "unplug", "silence")))
            case 1 | 2 | 3 | 4 | 5:
                acts.append(chance.choice((READ, WRITTEN)))
            case _:
                acts.append(_answer(chance))
    return chance.choice((64, 64, 64, 4, 200, -8, -100)), acts


FAILURES = {"stall": TransferStalled, "overflow": TransferOverflow, "error": TransferError, "unplug": Unplugged}


def _converse(case: tuple[int, list[bytes | str]], _: Path) -> None:
    count, acts = case
    left = list(acts)

    def respond(command: bytes) -> list[bytes | Exception]:
        (request,) = struct.unpack_from("<H", command, 10)
        said: list[bytes | Exception] = []
        while left and len(said) < 3:
            act = left.pop(0)
            if isinstance(act, str):
                said += [FAILURES[act](act)] if act in FAILURES else []
                break
            # The number is made to fit, or nothing behind the first check would be reached.
            said.append((act[:10] + struct.pack("<H", request) + act[12:])[:64] if len(act) >= 12 else act)
            if act[6:8] != b"\x05\x08":
                break
        return said

    clock = SteppedClock()
    memory = Memory(clock, respond)
    control = ControlChannel(NAME, memory, clock)
    begun_ns = clock.now_ns()
    try:
        if count > 0:
            assert len(control.read(0x1000, count)) == count
        else:
            control.write(0x1000, bytes(-count))
    finally:
        commands = len(memory.commands)
        pieces = -(-abs(count) // 64)
        assert commands <= ATTEMPTS * pieces, "more attempts than there are"
        assert (clock.now_ns() - begun_ns) * 1e-9 <= commands * (RESPONSE_TIME_S + PENDING_LIMIT_S + 0.1)


# --------------------------------------------------------------------------------------------------- registers


def _registers(chance: Random) -> bytes:
    data = bytearray(chance.choice((0x1E0, 0x44, 0x18, 64)))
    data[4:20] = b"Kingfisher\0\0\0\0\0\0"
    return damaged(chance, bytes(data))


def _read_registers(data: bytes, _: Path) -> None:
    readable = 0
    for parse in (parse_identification, parse_technology, parse_stream_needs, parse_manifest_entry):
        try:
            parse(data)
            readable += 1
        except ValueError as error:
            last = error
    if not readable:
        raise last


STRING = b"\x14\x03" + "Kingfisher"[:9].encode("utf-16-le")
DEVICE_INFO = bytes([20, 0x24, 0x01]) + struct.pack("<4H", 1, 1, 0, 1) + bytes(range(1, 10))
DESCRIPTORS = (STRING, DEVICE_INFO, bytes([5, 0x24, 0x7F, 1, 2]) + DEVICE_INFO)


def _read_descriptors(data: bytes, _: Path) -> None:
    find_device_info(data)
    if data[1:2] == b"\x03":
        parse_string(data)
    else:
        parse_device_info(data)


# ------------------------------------------------------------------------------------------------- description


def _zipped(text: bytes, stored: bool = False) -> bytes:
    with io.BytesIO() as file:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED if stored else zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(zipfile.ZipInfo("camera.xml", (2026, 1, 1, 0, 0, 0)), text)
        return file.getvalue()


SHORT = b'<?xml version="1.0"?><RegisterDescription/>'
PACKED = (
    _zipped(SHORT),
    _zipped(SHORT, stored=True),
    _zipped(XML.encode()),
    _zipped(bytes(200_000)),
    SHORT,
    XML.encode(),
)


def _manifest(chance: Random) -> tuple[bytes, bytes]:
    """A manifest and the file behind it; mostly with the length and SHA-1 that fit what is there."""
    file = damaged(chance, chance.choice(PACKED), PACKED) if chance.random() < 0.9 else chance.choice(PACKED)
    entry = struct.pack("<IIQQ20s20x", 0x01000000, (0 if file[:1] == b"<" else 1) << 10, 0x8000, len(file),
                        hashlib.sha1(file, usedforsecurity=False).digest())  # fmt: skip
    table = struct.pack("<Q", 1) + entry
    if chance.random() < 0.3:
        table = damaged(chance, table + entry)
    return table, file


class _Registers:
    """A control channel in front of a manifest at 0x100 and a file at 0x8000; what lies elsewhere is refused."""

    def __init__(self, table: bytes, file: bytes) -> None:
        self._parts = ((0x100, table + bytes(64 * 64)), (0x8000, file))

    def read(self, address: int, count: int) -> bytes:
        for start, data in self._parts:
            if start <= address and address + count <= start + len(data):
                return data[address - start : address - start + count]
        raise DeviceRefused(NAME, f"refused the read at {address:#x}", "Update the camera's firmware")

    def read_u64(self, address: int) -> int:
        return int.from_bytes(self.read(address, 8), "little")


def _fetch(case: tuple[bytes, bytes], _: Path) -> None:
    control: Any = _Registers(*case)
    text = read_description(control, NAME, 0x100)
    assert len(text) <= MAX_FILE_SIZE
    assert text.lstrip().startswith("<")


def _zip(chance: Random) -> tuple[bytes, int]:
    return damaged(chance, chance.choice(PACKED), PACKED), chance.choice((0, 1, 1, 1, 2))


def _unpack(case: tuple[bytes, int], _: Path) -> None:
    data, file_format = case
    check_sha1(data, None)
    assert unpack(data, file_format).lstrip().startswith("<")
    assert ManifestEntry(0, file_format, 0, len(data), None)


# ------------------------------------------------------------------------------------------------- node map

FEATURES = ("Width", "TriggerMode", "ExposureTime", "AcquisitionStart", "Root", "WidthReg", "Device", "Nothing")
TAGS = tuple(
    word.encode()
    for word in (
        "<pValue>Width</pValue>", "<pValue>WidthReg</pValue>", "<pMin>Width</pMin>", "<pAddress>Width</pAddress>", "<Length>0</Length>",
        "<Group>" * 40 + "</Group>" * 40, "<!DOCTYPE R [<!ENTITY e 'Width'>]>", "&e;",
        "<Length>-1</Length>", "<Length>999999999</Length>", "<Formula>1/0</Formula>", "<Address>0xFFFFFFFFFFFFFFFF</Address>",
        "<pIsAvailable>TriggerMode</pIsAvailable>", "<pSelected>Width</pSelected>", "<Inc>0</Inc>", "<Min>nan</Min>", "<!--", "]]>",
        "&amp;", "&x;", "<IntSwissKnife Name='K'><pVariable Name='W'>Width</pVariable><Formula>W/0</Formula></IntSwissKnife>", "<a>" * 300,
        "Name='Width'", "<pInvalidator>Width</pInvalidator>", "<pFeature>Root</pFeature>",
    )
)  # fmt: skip


def _xml(chance: Random) -> str:
    """Damaged in what it says, so that most of it still loads, or in its bytes."""
    text = XML
    if chance.random() < 0.75:
        for _ in range(chance.choice((1, 1, 1, 2, 3))):
            spots = [found.span(1) for found in _SAID.finditer(text)]
            begin, end = chance.choice(spots)
            other = chance.choice(spots)
            said = (
                text[slice(*other)],
                chance.choice(FEATURES),
                "0",
                "1",
                "4",
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
            text = text[:begin] + chance.choice(said) + text[end:]
        if chance.random() < 0.2:
            at = text.index("<Port")
            text = text[:at] + chance.choice(TAGS).decode() + text[at:]
        return text
    body = damaged(chance, XML.encode(), (XML.encode(),), (*TAGS, *(word.encode() for word in WORDS[:20])))
    return body.decode("utf-8", errors="replace")


_SAID = re.compile(r"(?:>|Name=')([^<>']+)[<']")


def _use_features(xml: str, _: Path) -> None:
    features = Features(NAME, xml, ControlChannel(NAME, RegisterMemory(), SteppedClock()))
    for name in FEATURES:
        if not features.has(name):
            continue
        features.writable(name)
        uses = (features.number, features.choice, features.choices, lambda n: features.set_number(n, 32.0),
                lambda n: features.choose(n, "On"), features.execute)  # fmt: skip
        for use in uses:
            with suppress(DeviceRefused):
                use(name)


# ------------------------------------------------------------------------------------------------------ stream

PACKETS = (leader(7), trailer(7), leader(8) + bytes(16), trailer(8, status=0xA101))


def _read_packet(data: bytes, _: Path) -> None:
    if data[:4] == b"U3VT":
        parse_trailer(data)
    else:
        parse_leader(data)


PAYLOAD = bytes(range(256)) * (PIXELS // 256)
GEOMETRY = StreamGeometry(WIDTH, HEIGHT, FORMATS["Mono8"], PIXELS, (PIXELS,), PACKET)


def _transfers(chance: Random) -> list[bytes | str]:
    """Some frames, of which transfers are damaged, lost, doubled, swapped."""
    transfers: list[bytes | str] = []
    for block in range(chance.randrange(1, 5)):
        transfers += [leader(block), PAYLOAD, trailer(block)]
    for _ in range(chance.randrange(1, 5)):
        at = chance.randrange(len(transfers) + 1)
        one = transfers[at] if at < len(transfers) else b""
        match chance.randrange(6):
            case 0 if at < len(transfers):
                del transfers[at]
            case 1:
                transfers.insert(at, one or chance.choice(PACKETS))
            case 2:
                transfers.insert(at, chance.choice(("stall", "overflow", "error", "stall", "overflow", "unplug")))
            case 3:
                transfers.insert(at, chance.randbytes(chance.choice((1, 32, 52, 1024, 1025, 5000))))
            case _ if isinstance(one, bytes) and at < len(transfers):
                transfers[at] = damaged(chance, one, PACKETS) if len(one) < 100 else one[: chance.randrange(PIXELS + 1)]
            case _:
                transfers.append(chance.choice(PACKETS))
    return transfers


def _stream(transfers: list[bytes | str], _folder: Path) -> None:
    clock = SteppedClock()
    pipe = Pipe(clock)
    pipe.send(*(FAILURES[one](one) if isinstance(one, str) else one for one in transfers))
    reader = StreamReader(NAME, pipe, GEOMETRY, clock)
    slot = np.zeros((HEIGHT, WIDTH), np.uint8)
    for _ in range(3 * len(transfers) + 5):
        slot[:] = 0xEE
        frame = reader.next_frame(slot, 0.1)
        if frame.status is FrameStatus.TIMEOUT:
            break
        if frame.status is FrameStatus.COMPLETE:
            assert frame.block_id is not None
            assert frame.camera_time_ns is not None
        else:
            assert frame.detail, "a damaged frame says why"
    else:
        raise AssertionError("the reader never came to the end of what was sent")
    _resynchronises(reader, pipe, slot)


def _resynchronises(reader: StreamReader, pipe: Pipe, slot: np.ndarray[Any, np.dtype[np.uint8]]) -> None:
    """Whatever was: one whole frame later the next one is read as it is."""
    frames: list[Frame] = []
    for block in (100, 101):
        pipe.send(leader(block), PAYLOAD, trailer(block))
        frames.append(reader.next_frame(slot, 0.5))
    whole = [frame.block_id for frame in frames if frame.status is FrameStatus.COMPLETE]
    assert 101 in whole or 100 in whole, [(f.status, f.detail) for f in frames]
    assert slot.tobytes() == PAYLOAD or 101 not in whole


TARGETS = (
    Target("gencp", "an answer on the control channel", _answer, _read_answer, (MalformedPacket,)),
    Target("control", "a whole exchange with a camera that answers anything", _conversation, _converse,
           (DeviceGone, DeviceRefused), NAME, cost=3.0),
    Target("registers", "the bootstrap registers", _registers, _read_registers, (ValueError,)),
    Target("descriptors", "the USB descriptors", lambda c: damaged(c, c.choice(DESCRIPTORS), DESCRIPTORS), _read_descriptors,
           (MalformedDescriptor,)),
    Target("manifest-entry", "a camera's manifest and the description behind it", _manifest, _fetch, (DeviceRefused,), NAME),
    Target("zip", "a description, raw or zipped", _zip, _unpack, (BadDescription,)),
    Target("nodes", "a description's XML and the features it makes", _xml, _use_features, (DeviceRefused, DeviceGone), NAME,
           cost=2.0),
    Target("packets", "leaders and trailers", lambda c: damaged(c, c.choice(PACKETS), PACKETS), _read_packet,
           (MalformedStreamPacket,)),
    Target("stream", "the image stream, frame after frame", _transfers, _stream, (DeviceGone,), NAME, cost=3.0),
)  # fmt: skip
