"""A cloud comes back as it was written, other programs can read it, and any damage is one clear error."""

from __future__ import annotations

import re
import resource
import signal
import struct
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.storage.atomic import StorageError
from appliance.storage.ply import PlyError, StoredCloud, encode_ply, read_ply, write_ply
from tests.appliance.storage.scenes import cloud


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


def test_a_cloud_that_cannot_be_written_leaves_the_old_one_whole(tmp_path: Path, small_files_only: None) -> None:
    path = tmp_path / "c.ply"
    write_ply(path, cloud(4))
    with pytest.raises(StorageError, match="File too large"):
        write_ply(path, cloud(4000))
    assert len(read_ply(path).points_mm) == 4


def test_round_trip_is_exact(tmp_path: Path) -> None:
    written = cloud(1000)
    write_ply(tmp_path / "c.ply", written)
    read = read_ply(tmp_path / "c.ply")
    for name in ("points_mm", "intensity", "modulation_dn", "ray_gap_mm", "sigma_mm"):
        assert getattr(read, name).dtype == getattr(written, name).dtype
        assert np.array_equal(getattr(read, name), getattr(written, name))


def test_the_bytes_are_what_the_header_announces(tmp_path: Path) -> None:
    """Read as any PLY reader would: by the property list alone."""
    one = cloud(3)
    write_ply(tmp_path / "c.ply", one)
    raw = (tmp_path / "c.ply").read_bytes()
    head, body = raw.split(b"end_header\n", 1)
    assert head.startswith(b"ply\nformat binary_little_endian 1.0\n")
    assert b"element vertex 3\n" in head
    types = {b"float": "f", b"uchar": "B"}
    properties = [line.split() for line in head.splitlines() if line.startswith(b"property")]
    assert [p[2].decode() for p in properties] == ["x", "y", "z", "intensity", "modulation", "ray_gap", "sigma"]
    row = struct.Struct("<" + "".join(types[p[1]] for p in properties))
    rows = list(row.iter_unpack(body))
    assert len(rows) == 3
    for k, (x, y, z, intensity, modulation, gap, sigma) in enumerate(rows):
        assert (x, y, z) == tuple(one.points_mm[k].tolist())
        assert intensity == one.intensity[k]
        assert (modulation, gap, sigma) == (one.modulation_dn[k], one.ray_gap_mm[k], one.sigma_mm[k])


def test_an_empty_cloud_is_a_cloud(tmp_path: Path) -> None:
    write_ply(tmp_path / "c.ply", cloud(0))
    assert read_ply(tmp_path / "c.ply").points_mm.shape == (0, 3)


def test_every_single_bit_flip_and_every_cut_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "c.ply"
    write_ply(path, cloud(4))
    whole = path.read_bytes()
    for position in range(len(whole)):
        for bit in (0, 5, 7):
            path.write_bytes(whole[:position] + bytes([whole[position] ^ (1 << bit)]) + whole[position + 1 :])
            with pytest.raises(PlyError, match=r"c\.ply"):
                read_ply(path)
        path.write_bytes(whole[:position])
        with pytest.raises(PlyError):
            read_ply(path)
    path.write_bytes(whole + b"\0")
    with pytest.raises(PlyError, match="bytes after the header"):
        read_ply(path)


def test_a_cloud_of_damaged_frames_says_so_in_its_header_and_any_change_of_that_is_seen(tmp_path: Path) -> None:
    path = tmp_path / "salvaged.ply"
    path.write_bytes(b"".join(bytes(part) for part in encode_ply(cloud(5), "damaged: frames_left.npy in sine-x-90")))
    assert read_ply(path).salvaged == "damaged: frames_left.npy in sine-x-90"
    assert (read_ply(path).points_mm == cloud(5).points_mm).all()
    path.write_bytes(path.read_bytes().replace(b"comment salvaged", b"comment salvagED"))
    with pytest.raises(PlyError, match="damaged header"):
        read_ply(path)
    path.write_bytes(b"".join(bytes(part) for part in encode_ply(cloud(5))))
    assert read_ply(path).salvaged is None


def test_a_missing_file_and_another_programs_file_are_named(tmp_path: Path) -> None:
    with pytest.raises(PlyError, match=r"none\.ply"):
        read_ply(tmp_path / "none.ply")
    (tmp_path / "other.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n")
    with pytest.raises(PlyError, match="not a cloud of this instrument"):
        read_ply(tmp_path / "other.ply")


def test_points_that_are_not_finite_and_lengths_that_differ_are_refused() -> None:
    bad = cloud(5)
    bad.points_mm[2, 1] = np.nan
    with pytest.raises(ValueError, match="1 of 5 points are not finite"):
        encode_ply(bad)
    sigma = cloud(5).sigma_mm
    short = StoredCloud(cloud(5).points_mm, cloud(4).intensity, sigma, sigma, sigma)
    with pytest.raises(ValueError, match=r"intensity has shape \(4,\)"):
        encode_ply(short)


@pytest.mark.parametrize("shape", [(5, 2), (5, 4), (5,), (5, 3, 1)])
def test_points_that_are_not_three_coordinates_each_are_refused_with_their_shape(shape: tuple[int, ...]) -> None:
    whole = cloud(5)
    flat = replace(whole, points_mm=np.zeros(shape, np.float32))
    with pytest.raises(ValueError, match=re.escape(f"points_mm has shape {shape}; (n, 3) is needed")):
        encode_ply(flat)


def test_a_million_points_cost_little_cpu() -> None:
    """Encoding is compared with one plain copy of the same bytes, in this run on this machine; of each the least of five, for others
    use its caches, too."""
    large = cloud(1_000_000)
    _, body = encode_ply(large)
    encoding_s, copying_s = [], []
    for _ in range(5):
        start = time.process_time()
        encode_ply(large)
        encoding_s.append(time.process_time() - start)
        start = time.process_time()
        bytes(body)
        copying_s.append(time.process_time() - start)
    assert min(encoding_s) < 40 * min(copying_s)
