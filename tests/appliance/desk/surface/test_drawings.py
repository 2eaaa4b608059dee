"""CAD models as other programs write them: read where they are unambiguous, else refused with the fact."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from appliance.desk.surface.drawing_file import NominalError, check_drawing
from appliance.desk.surface.drawings import read_triangles
from appliance.desk.surface.nominal import nominal_of, read_nominal

BOX: Any = trimesh.creation.box(extents=(20.0, 12.0, 6.0))
BINARY: bytes = BOX.export(file_type="stl")
WORDS: bytes = BOX.export(file_type="stl_ascii").encode()
"""ASCII: solid, facet normal, outer loop, vertex."""
FACETS = WORDS[WORDS.index(b"facet") : WORDS.rindex(b"endsolid")]
PLY: bytes = BOX.export(file_type="ply")
HEAD = PLY.index(b"end_header\n") + 11
OBJ: str = BOX.export(file_type="obj", header=None)
VARYING = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nproperty list uchar int more\nend_header\n0 0 0 2 1 1\n"


def stl_at(mm: float) -> bytes:
    far: Any = BOX.copy()
    far.apply_translation([mm, 0.0, 0.0])
    data: bytes = far.export(file_type="stl")
    return data


def with_corner(value: float) -> bytes:
    """The box in binary, with one coordinate of its third triangle replaced."""
    at = 84 + 2 * 50 + 12
    return BINARY[:at] + np.float32(value).tobytes() + BINARY[at + 4 :]


def triangle_to(coordinate: str) -> bytes:
    return f"v 0 0 0\nv 1 0 0\nv 0 {coordinate} 0\nf 1 2 3\n".encode()


def one_face_more(index: str) -> bytes:
    return f"{OBJ}\nf 1 2 {index}\n".encode()


@pytest.mark.parametrize(
    ("name", "data", "triangles"),
    [
        ("no name.stl", b"solid\n" + FACETS + b"end solid\n", 12),
        ("cr.stl", b"solid\r" + FACETS.replace(b"\n", b"\r") + b"endsolid\r", 12),
        ("latin-1.stl", "solid Flöte\n".encode("latin-1") + FACETS + "endsolid Flöte\n".encode("latin-1"), 12),
        ("gb.stl", "solid 圆筒\n".encode("gb18030") + FACETS + "endsolid 圆筒\n".encode("gb18030"), 12),
        ("bytes behind.stl", BINARY + b"made by another program", 12),
        ("binary that says solid.stl", b"solid box".ljust(80) + BINARY[80:], 12),
        ("cr in the head.ply", PLY[:HEAD].replace(b"\n", b"\r") + PLY[HEAD:], 12),
        # Single precision up to steps of a twentieth of a millimetre.
        ("far.stl", stl_at(5.0e5), 12),
        ("far.obj", triangle_to("-1e11"), 1),
        # A face names corners from either end.
        ("last.obj", one_face_more("8"), 13),
        ("from the end.obj", one_face_more("-8"), 13),
    ],
)  # fmt: skip
def test_what_is_unambiguous_is_read(name: str, data: bytes, triangles: int, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(data)
    assert len(read_triangles(tmp_path / name)[1]) == triangles
    if triangles == 12:
        nominal = read_nominal(tmp_path / name)
        assert len(nominal.vertices_mm) == 8, "corners that a file has three times are one"
        assert not nominal.open_edges.any()


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
        ("far.stl", stl_at(5.3e5), r"steps of 0\.0625 mm"),
        ("farther.stl", stl_at(3.0e6), r"3,000 m .* steps of 0\.25 mm"),
        ("far.obj", triangle_to("1.01e11"), r"beyond 1e\+11 mm"),
        ("zero.obj", one_face_more("0"), r"vertex 0 of 8: OBJ counts from 1"),
        ("over.obj", one_face_more("9"), r"a face names vertex 9 of 8"),
        ("under.obj", one_face_more("-9"), r"a face names vertex -9 of 8"),
        ("noise.obj", np.random.default_rng(1).bytes(4000), r"holds no triangles"),
        ("cut.ply", PLY[:-160], r"cut off: its head asks for"),
        ("list.ply", VARYING, r"vertices have a list \(more\)"),
        ("part.step", b"ISO-10303-21;", r"\.stl, \.obj, \.ply, in mm; convert \.step"),
    ],
)  # fmt: skip
def test_a_file_that_is_not_right_is_refused_with_the_fact(name: str, data: bytes, words: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(NominalError, match=words):
        read_triangles(tmp_path / name)


@pytest.mark.parametrize("make", [os.mkfifo, lambda path: path.symlink_to("/dev/zero")], ids=["pipe", "device"])
def test_a_pipe_or_a_device_is_refused_at_once(make: Callable[[Path], None], tmp_path: Path) -> None:
    make(tmp_path / "d.stl")
    with pytest.raises(NominalError, match="allowed are regular files"):
        read_triangles(tmp_path / "d.stl")


def test_a_file_of_more_than_two_gigabytes_is_refused_before_it_is_opened(tmp_path: Path) -> None:
    path = tmp_path / "large.stl"
    with path.open("wb") as file:
        file.truncate(2 * 1024**3)  # a hole: nothing is written
        assert check_drawing(path) == ".stl"
        file.truncate(2 * 1024**3 + 1)
    with pytest.raises(NominalError, match="larger than 2147483648 bytes"):
        check_drawing(path)


def test_triangles_without_area_are_left_out() -> None:
    faces = np.array([[0, 1, 2], [0, 1, 3]])
    for height_mm, kept in ((1.2e-12, 2), (0.9e-12, 1)):
        corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, height_mm, 0.0]])
        assert len(nominal_of(corners, faces).faces) == kept
    with pytest.raises(ValueError, match="no triangle has an area"):
        nominal_of(corners, faces[1:])


def test_double_precision_far_from_the_origin_is_held(tmp_path: Path) -> None:
    utm = np.array([5.0e8, 5.4e9, 0.0])
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in BOX.vertices + utm]
    lines += [f"f {a} {b} {c}" for a, b, c in BOX.faces + 1]
    (tmp_path / "utm.obj").write_text("\n".join(lines) + "\n")
    nominal = read_nominal(tmp_path / "utm.obj")
    np.testing.assert_array_equal(nominal.origin_mm, utm)
    np.testing.assert_allclose(np.sort(nominal.vertices_mm, axis=0), np.sort(BOX.vertices, axis=0), atol=1e-5)
