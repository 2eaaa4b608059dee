"""CAD models as other programs write them: read where they are unambiguous, else refused with the fact."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from appliance.surface.drawing_file import NominalError, checked_drawing
from appliance.surface.drawings import read_triangles
from appliance.surface.nominal import nominal_of, read_nominal

BOX: Any = trimesh.creation.box(extents=(20.0, 12.0, 6.0))
BINARY: bytes = BOX.export(file_type="stl")
WORDS: bytes = BOX.export(file_type="stl_ascii").encode()
"""ASCII: solid, facet normal, outer loop, vertex."""
VARYING = b"""ply
format ascii 1.0
element vertex 1
property float x
property float y
property float z
property list uchar int more
end_header
0 0 0 2 1 1
"""
OBJ: str = BOX.export(file_type="obj", header=None)


def body() -> bytes:
    """The lines of the facets."""
    start = WORDS.index(b"facet")
    return WORDS[start : WORDS.rindex(b"endsolid")]


@pytest.mark.parametrize(
    "data",
    [
        b"solid\n" + body() + b"end solid\n",
        b"solid\r" + body().replace(b"\n", b"\r") + b"endsolid\r",
        "solid Flöte\n".encode("latin-1") + body() + "endsolid Flöte\n".encode("latin-1"),
        "solid 圆筒\n".encode("gb18030") + body() + "endsolid 圆筒\n".encode("gb18030"),
        BINARY + b"made by another program",
        b"solid box".ljust(80) + BINARY[80:],
    ],
    ids=["end solid, no name", "CR alone", "Latin-1", "GB18030", "bytes behind", "binary that says solid"],
)
def test_an_stl_that_is_unambiguous_is_read(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "box.stl").write_bytes(data)
    nominal = read_nominal(tmp_path / "box.stl")
    assert (len(nominal.faces), len(nominal.vertices_mm)) == (12, 8)
    assert not nominal.open_edges.any()


def with_corner(value: float) -> bytes:
    """The box in binary, with one coordinate of its third triangle replaced."""
    data = bytearray(BINARY)
    data[84 + 2 * 50 + 12 : 84 + 2 * 50 + 16] = np.float32(value).tobytes()
    return bytes(data)


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("cut.stl", BINARY[: 84 + 5 * 50 + 20], r"5 of 12 triangles are there"),
        ("more.stl", BINARY + BINARY[-100:], r"states 12 triangles, and 14 are there"),
        ("words.stl", WORDS[: len(WORDS) // 2], r"cut off"),
        ("torn.stl", b"solid ?", r"holds no triangles"),
        ("nan.stl", with_corner(np.nan), r"1 of 12 triangles .* triangle 3"),
        ("inf.stl", with_corner(np.inf), r"1 of 12 triangles .* triangle 3"),
        ("large.stl", with_corner(1e30), r"1 of 12 triangles .* triangle 3"),
        ("zero.obj", OBJ.replace("f ", "f 0 ").encode(), r"corner 0 of 8: OBJ counts from 1"),
        ("over.obj", OBJ.replace("f ", "f 9 ").encode(), r"corner 9 of 8"),
        ("noise.obj", np.random.default_rng(1).bytes(4000), r"holds no triangles"),
        ("cut.ply", BOX.export(file_type="ply")[:-160], r"cut off: its head asks for"),
        (
            "list.ply",
            VARYING,
            r"vertices have a list \(more\)",
        ),
        ("part.step", b"ISO-10303-21;", r"\.stl, \.obj, \.ply, in mm; convert \.step"),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_right_is_refused_with_the_fact(
    name: str, data: bytes, words: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(NominalError, match=words) as caught:
        read_triangles(tmp_path / name)
    assert "charset" not in str(caught.value)


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")], ids=["pipe", "device"])
def test_a_pipe_or_a_device_is_refused_at_once(make: Callable[[Path], None], tmp_path: Path) -> None:
    make(tmp_path / "d.stl")
    with pytest.raises(NominalError, match="allowed are regular files"):
        read_triangles(tmp_path / "d.stl")


@pytest.mark.parametrize("bytes_more", [0, 1])
def test_a_file_of_more_than_two_gigabytes_is_refused_before_it_is_opened(bytes_more: int, tmp_path: Path) -> None:
    path = tmp_path / "large.stl"
    with path.open("wb") as file:
        file.truncate(2 * 1024**3 + bytes_more)  # a hole: nothing is written
    if not bytes_more:
        assert checked_drawing(path) == ".stl"
        return
    with pytest.raises(NominalError, match="larger than 2147483648 bytes"):
        checked_drawing(path)


def test_a_ply_head_with_carriage_returns_alone_is_read(tmp_path: Path) -> None:
    data: bytes = BOX.export(file_type="ply")
    end = data.index(b"end_header\n") + 11
    (tmp_path / "cr.ply").write_bytes(data[:end].replace(b"\n", b"\r") + data[end:])
    assert len(read_triangles(tmp_path / "cr.ply")[1]) == 12


@pytest.mark.parametrize(("at_mm", "read"), [(5.0e5, True), (5.3e5, False)])
def test_single_precision_is_read_up_to_steps_of_a_twentieth_of_a_millimetre(
    at_mm: float, read: bool, tmp_path: Path
) -> None:
    far: Any = BOX.copy()
    far.apply_translation([at_mm, 0.0, 0.0])
    far.export(tmp_path / "far.stl")
    if read:
        assert len(read_triangles(tmp_path / "far.stl")[1]) == 12
        return
    with pytest.raises(NominalError, match=r"steps of 0\.0625 mm"):
        read_triangles(tmp_path / "far.stl")


@pytest.mark.parametrize(("coordinate", "read"), [("1e11", True), ("-1e11", True), ("1.01e11", False)])
def test_no_corner_is_farther_than_a_hundred_thousand_kilometres(coordinate: str, read: bool, tmp_path: Path) -> None:
    (tmp_path / "far.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 {coordinate} 0\nf 1 2 3\n")
    if read:
        assert read_triangles(tmp_path / "far.obj")[0].max() >= 1.0
        return
    with pytest.raises(NominalError, match=r"beyond 1e\+11 mm"):
        read_triangles(tmp_path / "far.obj")


@pytest.mark.parametrize(("height_mm", "kept"), [(1.2e-12, True), (0.9e-12, False)])
def test_triangles_without_area_are_left_out(height_mm: float, kept: bool) -> None:
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, height_mm, 0.0]])
    faces = np.array([[0, 1, 2], [0, 1, 3]])
    assert len(nominal_of(corners, faces).faces) == (2 if kept else 1)
    if not kept:
        with pytest.raises(ValueError, match="no triangle has an area"):
            nominal_of(corners, faces[1:])


@pytest.mark.parametrize(("index", "refused"), [("-8", False), ("-9", True), ("8", False), ("9", True), ("0", True)])
def test_an_obj_face_names_corners_that_are_there_from_either_end(index: str, refused: bool, tmp_path: Path) -> None:
    (tmp_path / "box.obj").write_text(f"{OBJ}\nf 1 2 {index}\n")
    if refused:
        with pytest.raises(NominalError, match=f"a face names corner {index} of 8"):
            read_triangles(tmp_path / "box.obj")
    else:
        assert len(read_triangles(tmp_path / "box.obj")[1]) == 13


def test_single_precision_far_from_the_origin_is_refused_and_double_is_held(tmp_path: Path) -> None:
    far: Any = BOX.copy()
    far.apply_translation([3.0e6, 0.0, 0.0])
    far.export(tmp_path / "far.stl")
    with pytest.raises(NominalError, match=r"3,000 m .* steps of 0\.25 mm"):
        read_triangles(tmp_path / "far.stl")
    utm = np.array([5.0e8, 5.4e9, 0.0])
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in BOX.vertices + utm]
    lines += [f"f {a} {b} {c}" for a, b, c in BOX.faces + 1]
    (tmp_path / "utm.obj").write_text("\n".join(lines) + "\n")
    nominal = read_nominal(tmp_path / "utm.obj")
    np.testing.assert_array_equal(nominal.origin_mm, utm)
    np.testing.assert_allclose(np.sort(nominal.vertices_mm, axis=0), np.sort(BOX.vertices, axis=0), atol=1e-5)
