"""E57 and LAS files as two libraries read them that did not write them: the Rust crate ``e57``, and LASzip."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from appliance.export.content import CAMERA_FRAME, About
from appliance.export.files import write_surface
from appliance.surface.fusion import FusedCloud, PlacedScan, fuse
from tests.support.solids import Ball, looking, seen

UM = 1e-3
ABOUT = About("object pipe", CAMERA_FRAME)


@pytest.fixture(scope="module")
def surface() -> FusedCloud:
    """Points a metre from the origin, where a single-precision number is coarse."""
    pose = looking((0.0, 0.0, -500.0))
    ball = Ball((3.0, -2.0, 0.0), 8.0)
    scans = [seen([ball], pose, seed, size_px=(80, 80), steepest=60.0) for seed in range(2)]
    far = pose.moved((900.0, -700.0, 400.0))
    return fuse([PlacedScan(one, far.rotation, far.translation_mm) for one in scans])


def test_e57_is_the_same_to_a_micrometre_for_a_library_in_rust(surface: FusedCloud, tmp_path: Path) -> None:
    e57: Any = pytest.importorskip("e57", reason="there is no wheel of e57 for this Python")
    write_surface(tmp_path / "ball.e57", surface, ABOUT)
    read = e57.read_points(str(tmp_path / "ball.e57"))
    np.testing.assert_allclose(1000.0 * read.points, surface.points_mm, atol=UM)
    np.testing.assert_array_equal(read.intensity[:, 0], surface.grey)


def test_las_is_the_same_to_a_micrometre_for_laszip(surface: FusedCloud, tmp_path: Path) -> None:
    laszip: Any = pytest.importorskip("laszip", reason="there is no wheel of laszip for this Python")
    write_surface(tmp_path / "ball.las", surface, ABOUT)
    with (tmp_path / "ball.las").open("rb") as opened:
        reader = laszip.LasUnZipper(opened)
        header = reader.header
        count, length = header.extended_number_of_point_records, header.point_data_record_length
        raw = bytearray(count * length)
        reader.decompress_into(raw)
        steps = np.frombuffer(raw, np.dtype([("xyz", "<i4", 3), ("rest", f"V{length - 12}")]))["xyz"]
        scales = (header.x_scale_factor, header.y_scale_factor, header.z_scale_factor)
        offsets = (header.x_offset, header.y_offset, header.z_offset)
        largest_m = (header.max_x, header.max_y, header.max_z)
    points_m = steps * np.array(scales) + np.array(offsets)
    np.testing.assert_allclose(1000.0 * points_m, surface.points_mm, atol=UM)
    np.testing.assert_allclose(largest_m, points_m.max(axis=0), atol=1e-7)
