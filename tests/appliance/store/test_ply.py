"""A cloud comes back as it was written, other programs can read it, and any damage is one clear error."""

from __future__ import annotations

import re
import resource
import signal
import struct
import zlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.store.atomic import LocalFileSystem, StorageError
from appliance.store.ply import POINT, PlyError, encode_ply, read_ply
from tests.appliance.store.scenes import cloud


@pytest.fixture
def small_files_only() -> Iterator[None]:
    """No file can grow beyond a page."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, ignored)


@pytest.mark.usefixtures("small_files_only")
def test_a_cloud_that_cannot_be_written_leaves_the_old_one_whole(tmp_path: Path) -> None:
    path = tmp_path / "c.ply"
    LocalFileSystem().replace_file(path, *encode_ply(cloud(4)))
    with pytest.raises(StorageError, match="File too large"):
        LocalFileSystem().replace_file(path, *encode_ply(cloud(4000)))
    assert len(read_ply(path).points_mm) == 4


@pytest.mark.parametrize("points", [0, 1, 70_000])
def test_round_trip_is_exact_and_the_checksum_is_that_of_all_bytes(tmp_path: Path, points: int) -> None:
    written = cloud(points)
    LocalFileSystem().replace_file(tmp_path / "c.ply", *encode_ply(written))
    read = read_ply(tmp_path / "c.ply")
    for name in ("points_mm", "intensity", "modulation_dn", "ray_gap_mm", "sigma_mm"):
        assert getattr(read, name).dtype == getattr(written, name).dtype
        assert np.array_equal(getattr(read, name), getattr(written, name))
    head, body = (tmp_path / "c.ply").read_bytes().split(b"end_header\n", 1)
    assert f"comment body crc32 {zlib.crc32(body):08x}".encode() in head
    assert len(body) == points * 25


def test_the_bytes_are_what_the_header_announces() -> None:
    """Read as any PLY reader would: by the property list alone."""
    one = cloud(3)
    head, body = (bytes(part) for part in encode_ply(one))
    assert head.startswith(b"ply\nformat binary_little_endian 1.0\n")
    assert b"element vertex 3\n" in head
    properties = [line.split() for line in head.splitlines() if line.startswith(b"property")]
    assert [p[2].decode() for p in properties] == ["x", "y", "z", "intensity", "modulation", "ray_gap", "sigma"]
    row = struct.Struct("<" + "".join({b"float": "f", b"uchar": "B"}[p[1]] for p in properties))
    wanted = [
        (*one.points_mm[k].tolist(), one.intensity[k], one.modulation_dn[k], one.ray_gap_mm[k], one.sigma_mm[k])
        for k in range(3)
    ]
    assert list(row.iter_unpack(body)) == wanted


def test_every_single_bit_flip_and_every_cut_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "c.ply"
    LocalFileSystem().replace_file(path, *encode_ply(cloud(4)))
    whole = path.read_bytes()
    for position in range(len(whole)):
        for bit in (0, 5, 7):
            path.write_bytes(whole[:position] + bytes([whole[position] ^ (1 << bit)]) + whole[position + 1 :])
            with pytest.raises(PlyError, match=r"c\.ply"):
                read_ply(path)
    for data in (*(whole[:position] for position in range(len(whole))), whole + b"\0"):
        path.write_bytes(data)
        with pytest.raises(PlyError):
            read_ply(path)
    path.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n")
    with pytest.raises(PlyError, match="not a cloud of this instrument"):
        read_ply(path)
    with pytest.raises(PlyError, match=r"none\.ply"):
        read_ply(tmp_path / "none.ply")


def test_a_cloud_with_a_point_that_is_nowhere_is_refused_although_its_checksum_fits(tmp_path: Path) -> None:
    head, body = (bytes(part) for part in encode_ply(cloud(5)))
    for axis in "xyz":
        points = np.frombuffer(body, POINT).copy()
        points[axis][2] = np.inf
        wrong = points.tobytes()
        (tmp_path / "c.ply").write_bytes(re.sub(rb"crc32 [0-9a-f]{8}", b"crc32 %08x" % zlib.crc32(wrong), head) + wrong)
        with pytest.raises(PlyError, match="not finite"):
            read_ply(tmp_path / "c.ply")


def test_a_cloud_of_damaged_frames_says_so_and_any_change_of_that_is_seen(tmp_path: Path) -> None:
    path = tmp_path / "salvaged.ply"
    for told, read in (
        (None, None), ("", None), ("lost: gray-x-3", "lost: gray-x-3"), ("Gr\u00fc\u00dfe", "Gr??e"),
        ("x" * 1999, "x" * 1999), ("x" * 2001, "x" * 2000),
    ):  # fmt: skip
        path.write_bytes(b"".join(bytes(part) for part in encode_ply(cloud(5), told)))
        assert read_ply(path).salvaged == read
        assert (read_ply(path).points_mm == cloud(5).points_mm).all()
    path.write_bytes(path.read_bytes().replace(b"comment salvaged", b"comment salvagED"))
    with pytest.raises(PlyError, match="header"):
        read_ply(path)


def test_points_that_are_not_finite_and_other_shapes_are_refused() -> None:
    whole = cloud(5)
    bad = cloud(5)
    bad.points_mm[2, 1] = np.nan
    with pytest.raises(ValueError, match="1 of 5 points"):
        encode_ply(bad)
    for name, shape in (
        *(("points_mm", shape) for shape in ((5, 2), (5, 4), (5,), (5, 3, 1))), ("sigma_mm", (5, 1)), ("intensity", (4,)),
    ):  # fmt: skip
        dtype = getattr(whole, name).dtype
        with pytest.raises(ValueError, match=re.escape(f"{name.removesuffix('_mm')}") + r".*" + re.escape(f"{shape}")):
            encode_ply(replace(whole, **{name: np.zeros(shape, dtype)}))  # type: ignore[arg-type]
