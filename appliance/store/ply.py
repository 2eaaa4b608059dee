"""The file of a point cloud: binary little-endian PLY, mm, left camera frame, 25 bytes a point.

The header is the same for every cloud but for the number of points and the CRC-32 of the body, so that a reader
recognises any damage. Source: G. Turk, "The PLY Polygon File Format" (1994).
"""

from __future__ import annotations

import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from appliance.store.atomic import Bytes

POINT = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("intensity", "u1"),
        ("modulation", "<f4"),
        ("ray_gap", "<f4"),
        ("sigma", "<f4"),
    ]
)
"""One vertex, packed."""
_ROWS = 32768

_HEADER = """\
ply
format binary_little_endian 1.0
comment Kingfisher cloud 1: mm, left camera frame (x right, y down, z forward)
comment modulation in grey levels, ray_gap and sigma in mm
{remark}comment body crc32 {crc:08x}
element vertex {points}
property float x
property float y
property float z
property uchar intensity
property float modulation
property float ray_gap
property float sigma
end_header
"""
_REMARK = re.compile(rb"comment salvaged: ([ -~]{1,2000})\n")
"""Header line of a cloud that was salvaged, with the damage."""
_UNCHECKED = re.compile(rb"comment unchecked: ([ -~]{1,2000})\n")
"""Header line of a cloud whose points are unchecked, with the reason."""
_NUMBERS = re.compile(rb"comment body crc32 ([0-9a-f]{8})\nelement vertex (\d{1,10})\n")


class PlyError(Exception):
    """Error of a file that is no undamaged cloud of this instrument; the text says which file and why."""


class PointCloud(Protocol):
    """A cloud that can be written, such as those of ``appliance.measure.points``: arrays of equal length."""

    @property
    def points_mm(self) -> NDArray[np.float32]: ...
    @property
    def intensity(self) -> NDArray[np.uint8]: ...
    @property
    def modulation_dn(self) -> NDArray[np.float32]: ...
    @property
    def ray_gap_mm(self) -> NDArray[np.float32]: ...
    @property
    def sigma_mm(self) -> NDArray[np.float32]: ...


@dataclass(frozen=True, slots=True, eq=False)
class StoredCloud:
    """A cloud read from disk; a PointCloud. ``points_mm`` is (n, 3) float32, the others (n,)."""

    points_mm: NDArray[np.float32]
    intensity: NDArray[np.uint8]
    modulation_dn: NDArray[np.float32]
    ray_gap_mm: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    salvaged: str | None = None
    """The damage of the frames it was made of. Such a cloud is for looking at, not for measuring."""
    unchecked: str | None = None
    """The reason why points of one direction are unchecked. Such a cloud is not for measuring either."""


def encode_ply(cloud: PointCloud, salvaged: str | None = None, unchecked: str | None = None) -> tuple[bytes, Bytes]:
    """Return the header and body of the file; ``salvaged`` and ``unchecked`` are written into it.

    Raises ValueError where lengths differ or a coordinate is not finite.
    """
    n = len(cloud.points_mm)
    if cloud.points_mm.shape != (n, 3):
        raise ValueError(f"points_mm has shape {cloud.points_mm.shape}; (n, 3) is needed")
    values: dict[str, NDArray[np.uint8] | NDArray[np.float32]] = {
        "intensity": cloud.intensity,
        "modulation": cloud.modulation_dn,
        "ray_gap": cloud.ray_gap_mm,
        "sigma": cloud.sigma_mm,
    }
    for name, column in values.items():
        if column.shape != (n,):
            raise ValueError(f"{name} has shape {column.shape}; ({n},) is needed, one value per point")
    if not np.isfinite(cloud.points_mm).all():
        bad = int((~np.isfinite(cloud.points_mm)).any(axis=1).sum())
        raise ValueError(f"points_mm: {bad} of {n} points are not finite; remove them before storing")
    body = np.empty(n, POINT)
    raw = body.view(np.uint8).data if n else memoryview(b"")
    crc = 0
    for start in range(0, n, _ROWS):  # rows that fit the cache: interleaving columns is bound by memory otherwise
        rows = slice(start, min(start + _ROWS, n))
        block = body[rows]
        for axis, name in enumerate(("x", "y", "z")):
            block[name] = cloud.points_mm[rows, axis]
        for name, column in values.items():
            block[name] = column[rows]
        # The checksum is computed while the block is in the cache.
        crc = zlib.crc32(raw[rows.start * POINT.itemsize : rows.stop * POINT.itemsize], crc)
    return _header(crc, n, salvaged, unchecked), raw


def _header(crc: int, points: int, salvaged: str | None, unchecked: str | None) -> bytes:
    # The header is ASCII by the format's definition; names of files may have any characters.
    remarks = {"salvaged": salvaged, "unchecked": unchecked}
    plain = {name: (text or "").encode("ascii", "replace").decode("ascii")[:2000] for name, text in remarks.items()}
    remark = "".join(f"comment {name}: {text}\n" for name, text in plain.items() if text)
    return _HEADER.format(crc=crc, points=points, remark=remark).encode("ascii")


def read_ply(path: Path) -> StoredCloud:
    """Read a cloud that ``encode_ply`` made. Raises PlyError for any other or damaged file."""
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise PlyError(f"{path}: {error.strerror or error}") from error
    # Only the first bytes are searched: the same text may occur among the points.
    numbers = _NUMBERS.search(raw[:8192])
    if numbers is None:
        raise PlyError(f"{path}: not a cloud of this instrument (no checksum and point count in its header)")
    crc, n = int(numbers[1], 16), int(numbers[2])
    matches = (pattern.search(raw[:8192]) for pattern in (_REMARK, _UNCHECKED))
    salvaged, unchecked = (None if match is None else match[1].decode("ascii") for match in matches)
    header = _header(crc, n, salvaged, unchecked)
    # The header is made anew and compared, so that damage to any of its bytes is noticed.
    if not raw.startswith(header):
        raise PlyError(f"{path}: damaged header")
    body = memoryview(raw)[len(header) :]
    if len(body) != n * POINT.itemsize:
        raise PlyError(f"{path}: {len(body)} bytes after the header; {n} points need {n * POINT.itemsize}")
    if zlib.crc32(body) != crc:
        raise PlyError(f"{path}: damaged points (checksum {zlib.crc32(body):08x}, header says {crc:08x})")
    points = np.frombuffer(body, POINT)
    if not all(np.isfinite(points[axis]).all() for axis in "xyz"):
        raise PlyError(f"{path}: it has points that are not finite; no cloud of this instrument has")
    return StoredCloud(
        np.stack([points["x"], points["y"], points["z"]], axis=1),
        points["intensity"].copy(),
        points["modulation"].copy(),
        points["ray_gap"].copy(),
        points["sigma"].copy(),
        salvaged,
        unchecked,
    )
