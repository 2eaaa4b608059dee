"""Bootstrap registers and the way to the camera's description."""

from __future__ import annotations

import contextlib
import hashlib
import io
import struct
import zipfile
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.api import DeviceRefused
from drivers.camera.bootstrap import (
    ManifestEntry,
    parse_identification,
    parse_manifest_entry,
    parse_stream_needs,
    parse_technology,
)
from drivers.camera.description import BadDescription, choose, read_description, unpack
from tests.support.damage import damaged

XML = '<?xml version="1.0"?><RegisterDescription/>'


def archive(*members: tuple[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as made:
        for name, content in members:
            made.writestr(name, content)
    return buffer.getvalue()


def zipped(content: bytes) -> bytes:
    return archive(("camera.xml", content))


def test_each_register_is_read_at_its_place_and_strings_are_trimmed() -> None:
    memory = bytearray(0x1E0)
    for offset, text in (
        *((0x004, b"Vendor"), (0x044, b"m" * 64), (0x084, b"  Family \0rest"), (0x0C4, b"1.2")),
        *((0x144, b"KF-CAM-L"), (0x184, "Küste".encode())),
    ):
        memory[offset : offset + len(text)] = text
    struct.pack_into("<I", memory, 0x1CC, 200)
    struct.pack_into("<QQ", memory, 0x1D0, 0x4_0000, 0x1_0000)
    who = parse_identification(bytes(memory))
    assert (who.vendor, who.model, who.family, who.firmware) == ("Vendor", "m" * 64, "Family", "1.2")
    assert (who.serial, who.user_name) == ("KF-CAM-L", "Küste")
    assert who.max_response_time_s == pytest.approx(0.2)
    assert (who.manifest_address, who.sbrm_address) == (0x4_0000, 0x1_0000)
    memory = bytearray(0x44)
    struct.pack_into("<III", memory, 0x14, 1024, 2048, 1)
    struct.pack_into("<Q", memory, 0x20, 0x2_0000)
    struct.pack_into("<I", memory, 0x40, 8)
    told = parse_technology(bytes(memory))
    assert (told.max_command_size, told.max_answer_size, told.stream_count) == (1024, 2048, 1)
    assert (told.sirm_address, told.link_speed_mbps) == (0x2_0000, 5000)


@pytest.mark.parametrize(
    ("info", "control", "alignment", "enabled"),
    [
        (10 << 24, 1, 1024, True),
        (0xEA_FF_FF_FF, 0xFFFF_FFFE, 1024, False),
        (0, 1, 1, True),
        (0x1F << 24, 1, 1 << 31, True),
    ],
)
def test_stream_needs_read_alignment_as_a_power_of_two_and_no_neighbouring_bits(
    info: int, control: int, alignment: int, enabled: bool
) -> None:
    needs = parse_stream_needs(struct.pack("<IIQII", info, control, 1_920_000, 52, 32))
    assert (needs.alignment, needs.enabled) == (alignment, enabled)
    assert (needs.payload_size, needs.leader_size, needs.trailer_size) == (1_920_000, 52, 32)


@pytest.mark.parametrize(("stored", "sha1"), [(bytes(range(20)), bytes(range(20))), (bytes(20), None)])
@pytest.mark.parametrize(("schema", "file_format"), [(1 << 10, 1), (0xFFFF_07FF, 1), (0x3F << 10, 0x3F)])
def test_a_manifest_entry_says_format_place_and_hash_unless_that_is_zeros(
    stored: bytes, sha1: bytes | None, schema: int, file_format: int
) -> None:
    entry = parse_manifest_entry(struct.pack("<IIQQ20s20x", 0x01020003, schema, 0x5_0000, 4711, stored))
    assert entry == ManifestEntry(0x01020003, file_format, 0x5_0000, 4711, sha1)


MOST = 16 * 1024 * 1024


@pytest.mark.parametrize(
    ("entries", "chosen"),
    [
        ([(0x01000000, 0, 0, 10), (0x01010000, 1, 0, 10), (0x02000000, 5, 0, 10)], 1),
        ([(0x02000000, 5, 0, 10)], None),
        ([(1, 0, 0, 0), (1, 0, 0, MOST + 1)], None),
        ([(1, 0, 0, 0), (1, 0, 0, 1)], 1),
        ([(1, 0, 0, MOST)], 0),
        ([(1, 0, 1, 10), (1, 0, 2, 10)], 0),
    ],
    ids=["newest readable", "unknown format", "none or more than 16 MiB", "a byte", "16 MiB", "first of equals"],
)
def test_the_newest_readable_file_of_a_bearable_size_is_chosen(
    entries: list[tuple[int, int, int, int]], chosen: int | None
) -> None:
    files = [ManifestEntry(*one, sha1=None) for one in entries]
    assert choose(files) == (None if chosen is None else files[chosen])


@pytest.mark.parametrize(
    ("parse", "size"),
    [(parse_identification, 0x1E0), (parse_technology, 0x44), (parse_stream_needs, 0x18), (parse_manifest_entry, 64)],
)
def test_registers_that_come_short_are_named(parse: Callable[[bytes], object], size: int) -> None:
    parse(bytes(size))
    with pytest.raises(ValueError, match=f"{size - 1} bytes of .*, expected {size}"):
        parse(bytes(size - 1))


@pytest.mark.parametrize(
    ("data", "file_format", "text"),
    [
        (XML.encode() + b"\0\0", 0, XML),
        (b"\xef\xbb\xbf" + XML.encode(), 0, XML),  # a mark of the byte order is no part of the text
        (b"\n " + XML.encode(), 0, "\n " + XML),
        (zipped(XML.encode()), 1, XML),
        (archive(("read.me", b"<no/>"), ("docs/", b""), ("CAMERA.XML", XML.encode())), 1, XML),
        (archive(("description", XML.encode())), 1, XML),
        (archive(("a.xml", XML.encode()), method=zipfile.ZIP_STORED), 1, XML),
        (zipped(b"<" + b" " * (MOST - 1)), 1, "<" + " " * (MOST - 1)),
    ],
    ids=range(8),
)
def test_a_description_is_read_raw_or_out_of_an_archive(data: bytes, file_format: int, text: str) -> None:
    assert unpack(data, file_format) == text


GREEDY = bytearray(zipped(XML.encode()))
GREEDY[GREEDY.index(b"PK\1\2") + 10] = 14


@pytest.mark.parametrize(
    ("data", "file_format", "said"),
    [
        (archive(), 1, "empty"),
        (archive(("docs/", b"")), 1, "empty"),
        (archive(("a.xml", XML.encode()), method=zipfile.ZIP_BZIP2), 1, "method 12; known are 0 and 8"),
        (bytes(GREEDY), 1, "method 14"),
        (zipped(XML.encode()).replace(b"camera.xml", b"\0amera.xml"), 1, "zipped description"),
        (zipped(b"<" + b" " * MOST), 1, f"more than {MOST} bytes"),
        (b"PK, but no archive", 1, "cannot be read"),
        (XML.encode(), 2, "format 2"),
        (b"  text", 0, "not XML"),
    ],
    ids=range(9),
)
def test_a_description_that_cannot_be_read_says_why(data: bytes, file_format: int, said: str) -> None:
    with pytest.raises(BadDescription, match=said):
        unpack(data, file_format)


class Memory:
    """A control channel in front of some bytes; what lies behind them is refused. A ``damaged`` file comes whole when it is asked for again."""

    def __init__(self, content: bytes, *, damaged: int = 0) -> None:
        self.fetched = 0
        self._content, self._damaged = content, damaged

    def read(self, address: int, count: int) -> bytes:
        if address + count > len(self._content):
            raise DeviceRefused("camera.left", f"refused the read at {address:#x}", "Update the camera's firmware")
        data = self._content[address : address + count]
        if address == 0x2000:
            self.fetched += 1
            data = data[:-1] + b"!" if self.fetched <= self._damaged else data
        return data

    def read_u64(self, address: int) -> int:
        return int.from_bytes(self.read(address, 8), "little")


def manifest(file: bytes, sha1: bytes, count: int = 1) -> bytes:
    """A manifest and, 8 KiB behind it, its file."""
    entry = struct.pack("<IIQQ20s20x", 1 << 24, (file[:1] != b"<") << 10, 0x2000, len(file), sha1)
    others = struct.pack("<IIQQ40x", 0, 9, 0, 0) * (count - 1)
    return (struct.pack("<Q", count) + entry + others).ljust(0x2000, b"\0") + file


def fetched(memory: Memory) -> str:
    return read_description(memory, "camera.left", 0)  # type: ignore[arg-type]


@pytest.mark.parametrize("damaged", [1, 9])
def test_a_file_that_came_damaged_is_fetched_once_more_and_not_for_ever(damaged: int) -> None:
    memory = Memory(manifest(XML.encode(), hashlib.sha1(XML.encode()).digest()), damaged=damaged)
    if damaged == 1:
        assert fetched(memory) == XML
    else:
        with pytest.raises(DeviceRefused, match=r"camera.left: .*SHA-1"):
            fetched(memory)
    assert memory.fetched == 2


def test_a_manifest_of_1_to_64_files_is_read_whole() -> None:
    for count in (1, 64):
        assert fetched(Memory(manifest(XML.encode(), bytes(20), count))) == XML
    for count in (0, 65):
        with pytest.raises(DeviceRefused, match=f"{count} files; 1 to 64"):
            fetched(Memory(manifest(XML.encode(), bytes(20), count)))


@st.composite
def described(draw: st.DrawFn) -> bytes:
    """A manifest and a file whose length and SHA-1 mostly fit."""
    file = draw(damaged([XML.encode(), zipped(XML.encode()), zipped(bytes(200_000))]))
    whole = manifest(file, hashlib.sha1(file).digest())
    table = draw(st.just(whole[:72]) | damaged([whole[:72]]))
    return table[:0x2000].ljust(0x2000, b"\0") + file


@given(described())
def test_a_damaged_manifest_gives_xml_or_a_refusal(content: bytes) -> None:
    with contextlib.suppress(DeviceRefused):
        assert fetched(Memory(content)).lstrip().startswith("<")
