"""Bootstrap registers and the way to the camera's description."""

from __future__ import annotations

import hashlib
import io
import struct
import zipfile

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.camera.bootstrap import (
    ManifestEntry,
    parse_identification,
    parse_manifest_entry,
    parse_stream_needs,
    parse_technology,
)
from drivers.camera.description import BadDescription, check_sha1, choose, unpack

XML = '<?xml version="1.0"?><RegisterDescription/>'


def zipped(content: bytes, name: str = "camera.xml") -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)
    return buffer.getvalue()


def test_identification_reads_each_string_at_its_place() -> None:
    memory = bytearray(0x1E0)
    for offset, text in ((0x004, b"Vendor"), (0x044, b"Model"), (0x0C4, b"1.2"), (0x144, b"KF-CAM-L")):
        memory[offset : offset + len(text)] = text
    struct.pack_into("<I", memory, 0x1CC, 200)
    struct.pack_into("<QQ", memory, 0x1D0, 0x4_0000, 0x1_0000)
    who = parse_identification(bytes(memory))
    assert (who.vendor, who.model, who.firmware, who.serial) == ("Vendor", "Model", "1.2", "KF-CAM-L")
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


def test_a_manifest_entry_says_format_place_and_hash() -> None:
    sha1 = bytes(range(20))
    entry = parse_manifest_entry(struct.pack("<IIQQ20s20x", 0x01020003, 1 << 10, 0x5_0000, 4711, sha1))
    assert entry == ManifestEntry(0x01020003, 1, 0x5_0000, 4711, sha1)


def test_a_hash_of_zeros_is_no_hash() -> None:
    assert parse_manifest_entry(struct.pack("<IIQQ40x", 1, 0, 8, 8)).sha1 is None


def test_the_newest_readable_file_is_chosen() -> None:
    old = ManifestEntry(0x01000000, 0, 0, 10, None)
    new = ManifestEntry(0x01010000, 1, 0, 10, None)
    unknown = ManifestEntry(0x02000000, 5, 0, 10, None)
    assert choose([old, new, unknown]) == new
    assert choose([unknown]) is None


def test_a_description_is_read_raw_and_zipped() -> None:
    assert unpack(XML.encode() + b"\0\0", 0) == XML
    assert unpack(zipped(XML.encode()), 1) == XML


def test_one_flipped_bit_is_found_by_the_hash() -> None:
    data = bytearray(zipped(XML.encode()))
    sha1 = hashlib.sha1(data).digest()
    check_sha1(bytes(data), sha1)
    data[40] ^= 1
    with pytest.raises(BadDescription, match="SHA-1"):
        check_sha1(bytes(data), sha1)


def test_a_zip_bomb_is_not_unpacked() -> None:
    with pytest.raises(BadDescription, match="unpacks to more than"):
        unpack(zipped(b"<" + b" " * (17 * 1024 * 1024)), 1)


@given(st.binary(max_size=300), st.integers(0, 3))
def test_arbitrary_bytes_are_xml_or_a_named_error(data: bytes, file_format: int) -> None:
    for candidate in (data, zipped(data)[:-7] + data):
        try:
            assert unpack(candidate, file_format).lstrip().startswith("<")
        except BadDescription:
            continue
