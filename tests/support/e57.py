"""Owns a reader of E57 files, written from ASTM E2807-11 and for tests only: pages with their checksums, XML, packets of floats."""

from __future__ import annotations

import io
import struct
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

E57 = "{http://www.astm.org/COMMIT/E57/2010-e57-v1.0}"
_CASTAGNOLI = 0x82F63B78
"""CRC-32C's polynomial, reflected (ASTM E2807-11, 6.3.1; RFC 3720)."""


@dataclass(frozen=True)
class E57Scan:
    """The first scan entry: texts, and its columns by name with the prefix of their extension."""

    name: str
    description: str
    bounds_m: dict[str, float]
    columns: dict[str, NDArray[np.float64]]
    namespaces: dict[str, str]


def _crc32c(data: bytes) -> int:
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (_CASTAGNOLI if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def read_e57(path: Path) -> E57Scan:
    raw = path.read_bytes()
    magic, major, _minor, length, xml_at, xml_length, page = struct.unpack_from("<8sIIQQQQ", raw)
    assert (magic, major, length, page) == (b"ASTM-E57", 1, len(raw), 1024)
    pages = [raw[k : k + page] for k in range(0, len(raw), page)]
    for one in pages[:2] + pages[-2:]:
        # The checksum alone is big-endian.
        assert struct.unpack(">I", one[-4:])[0] == _crc32c(one[:-4])
    logical = b"".join(one[:-4] for one in pages)

    def at(physical: int) -> int:
        assert physical % page < page - 4
        return int(physical // page * (page - 4) + physical % page)

    text = logical[at(xml_at) : at(xml_at) + xml_length]
    namespaces = dict(tuple(pair) for _, pair in ET.iterparse(io.BytesIO(text), events=["start-ns"]))
    root = ET.fromstring(text)
    scan = root.find(f"{E57}data3D/{E57}vectorChild")
    assert scan is not None
    points = scan.find(f"{E57}points")
    assert points is not None
    prefixes = {name: prefix for prefix, name in namespaces.items()}
    names = []
    prototype = points.find(f"{E57}prototype")
    assert prototype is not None
    for node in prototype:
        # An integer that can only be 0 has no bytes.
        constant = node.get("type") == "Integer" and (node.get("minimum"), node.get("maximum")) == ("0", "0")
        assert constant or (node.get("type"), node.get("precision")) == ("Float", "single")
        space, _, tag = node.tag[1:].partition("}")
        names.append(f"{prefixes[space]}:{tag}" if prefixes[space] else tag)
    streams = _streams(logical, at(int(points.get("fileOffset", ""))), at, len(names))
    count = int(points.get("recordCount", ""))
    columns = {name: np.frombuffer(one, "<f4").astype(float) for name, one in zip(names, streams, strict=True)}
    columns.pop("cartesianInvalidState", None)
    assert all(len(column) == count for column in columns.values())
    bounds = scan.find(f"{E57}cartesianBounds")
    assert bounds is not None
    return E57Scan(
        scan.findtext(f"{E57}name", ""),
        scan.findtext(f"{E57}description", ""),
        {node.tag.partition("}")[2]: float(node.text or 0.0) for node in bounds},
        columns,
        namespaces,
    )


def _streams(logical: bytes, start: int, at: Callable[[int], int], count: int) -> list[bytes]:
    """The byte streams of a compressed vector's section, whose data packets follow each other."""
    kind, length, data, _index = struct.unpack_from("<B7xQQQ", logical, start)
    assert kind == 1
    here, end = at(data), start + length
    streams = [b""] * count
    while here < end:
        packet, _flags, less_one = struct.unpack_from("<BBH", logical, here)
        if packet == 1:
            (number,) = struct.unpack_from("<H", logical, here + 4)
            assert number == count
            lengths = struct.unpack_from(f"<{count}H", logical, here + 6)
            place = here + 6 + 2 * count
            for k, long in enumerate(lengths):
                streams[k] += logical[place : place + long]
                place += long
        here += less_one + 1
    return streams
