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
from drivers.camera.description import BadDescription, check_sha1, choose, read_description, unpack
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


def test_identification_reads_each_string_at_its_place_trimmed() -> None:
    memory = bytearray(0x1E0)
    for offset, text in (
        *((0x004, b"Vendor"), (0x044, b"Model"), (0x084, b"  Family \0rest"), (0x0C4, b"1.2")),
        *((0x144, b"KF-CAM-L"), (0x184, "Küste".encode())),
    ):
        memory[offset : offset + len(text)] = text
    struct.pack_into("<I", memory, 0x1CC, 200)
    struct.pack_into("<QQ", memory, 0x1D0, 0x4_0000, 0x1_0000)
    who = parse_identification(bytes(memory))
    assert (who.vendor, who.model, who.family, who.firmware) == ("Vendor", "Model", "Family", "1.2")
    assert (who.serial, who.user_name) == ("KF-CAM-L", "Küste")
    assert who.max_response_time_s == pytest.approx(0.2)
    assert (who.manifest_address, who.sbrm_address) == (0x4_0000, 0x1_0000)


def test_a_string_without_its_nul_ends_at_64_bytes() -> None:
    memory = bytearray(0x1E0)
    memory[0x044:0x084] = b"m" * 64
    memory[0x084:0x088] = b"next"
    assert parse_identification(bytes(memory)).model == "m" * 64


def test_technology_reads_each_register_at_its_place() -> None:
    memory = bytearray(0x44)
    struct.pack_into("<III", memory, 0x14, 1024, 2048, 1)
    struct.pack_into("<Q", memory, 0x20, 0x2_0000)
    struct.pack_into("<I", memory, 0x40, 8)
    technology = parse_technology(bytes(memory))
    assert (technology.max_command_size, technology.max_answer_size, technology.stream_count) == (1024, 2048, 1)
    assert technology.sirm_address == 0x2_0000
    assert technology.link_speed_mbps == 5000


def test_stream_needs_read_alignment_as_a_power_of_two() -> None:
    needs = parse_stream_needs(struct.pack("<IIQII", 10 << 24, 1, 1_920_000, 52, 32))
    assert (needs.alignment, needs.enabled) == (1024, True)
    assert (needs.payload_size, needs.leader_size, needs.trailer_size) == (1_920_000, 52, 32)


@pytest.mark.parametrize(("stored", "sha1"), [(bytes(range(20)), bytes(range(20))), (bytes(20), None)])
def test_a_manifest_entry_says_format_place_and_hash_unless_that_is_zeros(stored: bytes, sha1: bytes | None) -> None:
    entry = parse_manifest_entry(struct.pack("<IIQQ20s20x", 0x01020003, 1 << 10, 0x5_0000, 4711, stored))
    assert entry == ManifestEntry(0x01020003, 1, 0x5_0000, 4711, sha1)


def test_the_newest_readable_file_is_chosen() -> None:
    old = ManifestEntry(0x01000000, 0, 0, 10, None)
    new = ManifestEntry(0x01010000, 1, 0, 10, None)
    unknown = ManifestEntry(0x02000000, 5, 0, 10, None)
    assert choose([old, new, unknown]) == new
    assert choose([unknown]) is None


def test_one_flipped_bit_is_found_by_the_hash() -> None:
    data = bytearray(zipped(XML.encode()))
    sha1 = hashlib.sha1(data).digest()
    check_sha1(bytes(data), sha1)
    data[40] ^= 1
    with pytest.raises(BadDescription, match="SHA-1"):
        check_sha1(bytes(data), sha1)


@pytest.mark.parametrize(
    ("parse", "size"),
    [(parse_identification, 0x1E0), (parse_technology, 0x44), (parse_stream_needs, 0x18), (parse_manifest_entry, 64)],
)
def test_registers_that_come_short_are_named(parse: Callable[[bytes], object], size: int) -> None:
    parse(bytes(size))
    with pytest.raises(ValueError, match=f"{size - 1} bytes of .*, expected {size}"):
        parse(bytes(size - 1))


def test_neighbouring_bits_of_a_register_do_not_count() -> None:
    needs = parse_stream_needs(struct.pack("<IIQII", 0xEA_FF_FF_FF, 0xFFFF_FFFE, 8, 52, 32))
    assert (needs.alignment, needs.enabled) == (1024, False)
    assert parse_stream_needs(struct.pack("<IIQII", 0, 1, 8, 52, 32)).alignment == 1
    assert parse_stream_needs(struct.pack("<IIQII", 0x1F << 24, 1, 8, 52, 32)).alignment == 1 << 31
    assert parse_manifest_entry(struct.pack("<IIQQ40x", 1, 0xFFFF_07FF, 8, 8)).file_format == 1
    assert parse_manifest_entry(struct.pack("<IIQQ40x", 1, 0x3F << 10, 8, 8)).file_format == 0x3F


def test_a_file_of_no_bytes_or_more_than_16_mib_is_passed_over_and_of_equals_the_first_is_taken() -> None:
    most = 16 * 1024 * 1024

    def entry(size: int, address: int = 0) -> ManifestEntry:
        return ManifestEntry(1, 0, address, size, None)

    assert choose([entry(0), entry(most + 1)]) is None
    assert choose([entry(0), entry(1)]) == entry(1)
    assert choose([entry(most)]) == entry(most)
    assert choose([entry(5, 1), entry(5, 2)]) == entry(5, 1)


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
    ],
)
def test_a_description_is_read_raw_or_out_of_an_archive(data: bytes, file_format: int, text: str) -> None:
    assert unpack(data, file_format) == text


@pytest.mark.parametrize(
    ("data", "file_format", "said"),
    [
        (archive(), 1, "the zipped description is empty"),
        (archive(("docs/", b"")), 1, "the zipped description is empty"),
        (archive(("a.xml", XML.encode()), method=zipfile.ZIP_BZIP2), 1, "packed by method 12; known are 0 and 8"),
        (b"PK, but no archive", 1, "cannot be read"),
        (XML.encode(), 2, r"description in format 2; known are 0 \(raw\) and 1 \(zip\)"),
        (b"  text", 0, "the description is not XML"),
    ],
)
def test_a_description_that_cannot_be_read_says_why(data: bytes, file_format: int, said: str) -> None:
    with pytest.raises(BadDescription, match=said):
        unpack(data, file_format)


def test_a_description_may_unpack_to_16_mib_and_not_to_a_byte_more() -> None:
    most = 16 * 1024 * 1024
    assert len(unpack(zipped(b"<" + b" " * (most - 1)), 1)) == most
    with pytest.raises(BadDescription, match=f"unpacks to more than {most} bytes"):
        unpack(zipped(b"<" + b" " * most), 1)


class Files:
    """A control channel that gives one manifest, and a file that may come damaged."""

    def __init__(self, *versions: bytes, sha1: bytes, count: int = 1) -> None:
        self.count, self.fetched, self._versions = count, 0, versions
        entry = struct.pack("<IIQQ20s20x", 1, 0, 0x5000, len(versions[0]), sha1)
        self._table = entry + struct.pack("<IIQQ40x", 0, 9, 0, 0) * (count - 1)

    def read_u64(self, address: int) -> int:
        assert address == 0x4000
        return self.count

    def read(self, address: int, count: int) -> bytes:
        if address == 0x4008:
            assert count == len(self._table) == 64 * self.count
            return self._table
        assert (address, count) == (0x5000, len(self._versions[0]))
        self.fetched += 1
        return self._versions[min(self.fetched, len(self._versions)) - 1]


def fetched(files: Files) -> str:
    return read_description(files, "camera.left", 0x4000)  # type: ignore[arg-type]


def test_a_file_that_came_damaged_is_fetched_once_more_and_not_for_ever() -> None:
    whole, sha1 = XML.encode(), hashlib.sha1(XML.encode()).digest()
    files = Files(whole[:-1] + b"!", whole, sha1=sha1)
    assert fetched(files) == XML
    assert files.fetched == 2
    files = Files(whole[:-1] + b"!", sha1=sha1)
    with pytest.raises(DeviceRefused, match="does not match its SHA-1") as caught:
        fetched(files)
    assert (files.fetched, caught.value.device) == (2, "camera.left")


def test_a_manifest_of_64_files_is_read_whole() -> None:
    assert fetched(Files(XML.encode(), sha1=bytes(20), count=64)) == XML
    with pytest.raises(DeviceRefused, match="claims 65 files; 1 to 64"):
        fetched(Files(XML.encode(), sha1=bytes(20), count=65))


@given(
    st.binary(max_size=300)
    | damaged([XML.encode(), zipped(XML.encode()), archive(("a.xml", XML.encode()), method=zipfile.ZIP_STORED)]),
    st.integers(0, 3),
)
def test_arbitrary_bytes_are_xml_or_a_named_error(data: bytes, file_format: int) -> None:
    for candidate in (data, zipped(data)[:-7] + data):
        try:
            assert unpack(candidate, file_format).lstrip().startswith("<")
        except BadDescription:
            continue


@given(damaged([bytes(4) + b"Kingfisher".ljust(0x1DC, b"\0"), bytes(0x44), bytes(64)]))
def test_arbitrary_registers_are_read_or_a_named_error(data: bytes) -> None:
    for parse in (parse_identification, parse_technology, parse_stream_needs, parse_manifest_entry):
        with contextlib.suppress(ValueError):
            parse(data)


class Memory:
    """A control channel in front of some bytes; what lies behind them is refused."""

    def __init__(self, content: bytes) -> None:
        self._content = content

    def read(self, address: int, count: int) -> bytes:
        if address + count > len(self._content):
            raise DeviceRefused("camera.left", f"refused the read at {address:#x}", "Update the camera's firmware")
        return self._content[address : address + count]

    def read_u64(self, address: int) -> int:
        return int.from_bytes(self.read(address, 8), "little")


@st.composite
def described(draw: st.DrawFn) -> bytes:
    """A manifest and, 8 KiB behind it, its file, whose length and SHA-1 mostly fit."""
    file = draw(damaged([XML.encode(), zipped(XML.encode()), zipped(bytes(200_000))]))
    entry = struct.pack("<IIQQ", 1 << 24, (file[:1] != b"<") << 10, 0x2000, len(file)) + hashlib.sha1(file).digest()
    table = struct.pack("<Q", 1) + entry.ljust(64, b"\0")
    return draw(st.just(table) | damaged([table]))[:0x2000].ljust(0x2000, b"\0") + file


@given(described())
def test_a_damaged_manifest_gives_xml_or_a_refusal(content: bytes) -> None:
    with contextlib.suppress(DeviceRefused):
        assert read_description(Memory(content), "camera.left", 0).lstrip().startswith("<")  # type: ignore[arg-type]


def test_a_zipped_description_without_a_name_or_in_a_greedy_packing_is_refused() -> None:
    with pytest.raises(BadDescription):
        unpack(zipped(XML.encode()).replace(b"camera.xml", b"\0amera.xml"), 1)
    lzma = bytearray(zipped(XML.encode()))
    at = lzma.index(b"PK\1\2")
    lzma[at + 10 : at + 12] = struct.pack("<H", 14)
    with pytest.raises(BadDescription, match="packed by method 14"):
        unpack(bytes(lzma), 1)
