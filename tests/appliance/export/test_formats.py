"""Every file that leaves the instrument is read back, by a reader that did not write it, to a micrometre."""

from __future__ import annotations

import importlib.util
import json
import re
import struct
import zipfile
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from appliance.export.content import CAMERA_FRAME, About
from appliance.export.files import write_mesh, write_scan, write_surface
from appliance.export.placed import PlacedGrid, write_placed
from appliance.export.suffixes import ExportError, require_library
from appliance.reconstruct.organised import OrganisedCloud
from appliance.surface.fusion import FusedCloud, PlacedScan, fuse, with_places
from appliance.surface.libraries import MissingLibraryError
from appliance.surface.mesh import Mesh, mesh_of_scan
from tests.support.e57 import read_e57
from tests.support.solids import Ball, looking, seen

UM = 0.001
ABOUT = About("scan 000007", CAMERA_FRAME, ("calibration abc", "water – 10 °C"))


@pytest.fixture(scope="module")
def cloud() -> OrganisedCloud:
    """A ball beside the axis, with a border of pixels without points."""
    return seen([Ball((3.0, -2.0, 0.0), 8.0)], looking((0.0, 0.0, -500.0)), 5, size_px=(120, 100), steepest=70.0)


@pytest.fixture(scope="module")
def surface() -> FusedCloud:
    """Points far from the origin, where float32 is coarse."""
    pose = looking((0.0, 0.0, -500.0))
    ball = Ball((3.0, -2.0, 0.0), 8.0)
    scans = [seen([ball], pose, seed, size_px=(80, 80), steepest=60.0) for seed in range(2)]
    far = pose.moved((900.0, -700.0, 400.0))
    return fuse([PlacedScan(one, far.rotation, far.translation_mm) for one in scans])


@dataclass(frozen=True)
class Columns:
    """What a reader that did not write the file found in it, in mm or in the file's own unit; and the words beside."""

    xyz: NDArray[Any]
    intensity: NDArray[Any]
    normals: NDArray[Any]
    others: dict[str, NDArray[Any]]
    words: str


def of_ply(path: Path) -> Columns:
    read: Any = trimesh.load(path, process=False)
    data = read.metadata["_ply_raw"]["vertex"]["data"]
    others = {name.removesuffix("_mm"): data[name] for name in data.dtype.names}
    xyz, normals = (np.stack([data[f"{n}{axis}"] for axis in "xyz"], 1) for n in ("", "n"))
    words = path.read_bytes().partition(b"end_header")[0].decode("ascii")
    return Columns(xyz, data["blue"], normals, others, words)


def of_e57(path: Path, scale: float = 1000.0) -> Columns:
    read = read_e57(path)
    others = {
        name.removeprefix("kf:"): (1.0 if name == "kf:views" else scale) * values
        for name, values in read.columns.items()
        if name.startswith("kf:")
    }
    xyz, normals = (np.stack([read.columns[f"{of}{axis}"] for axis in "XYZ"], 1) for of in ("cartesian", "nor:normal"))
    assert read.namespaces["nor"] == "http://www.libe57.org/E57_NOR_surface_normals.txt"
    for axis, end in (("x", "Minimum"), ("z", "Maximum")):
        ends = xyz[:, "xyz".index(axis)]
        assert read.bounds_m[f"{axis}{end}"] == pytest.approx(ends.min() if end == "Minimum" else ends.max())
    return Columns(scale * xyz, read.columns["intensity"], normals, others, f"{read.name}: {read.description}")


def of_las(path: Path, unit: str = "metre") -> Columns:
    """Points of an LAS 1.4 file of point format 6, from the tables of ASPRS' specification."""
    raw, scale = path.read_bytes(), 1000.0 if unit == "metre" else 1.0
    assert (raw[:4], raw[24], raw[25]) == (b"LASF", 1, 4)
    assert raw[26:58].rstrip(b"\0") == f"Kingfisher, unit {unit}".encode()
    assert raw[58:90].rstrip(b"\0") == b"kingfisher"
    assert raw[6] & 16, "its coordinate system is in words"
    assert raw[90:94] == bytes(4), "no date, else the same points would not give the same file"
    header, data, vlrs, kind, length = struct.unpack_from("<HIIBH", raw, 94)
    assert (kind, header) == (6, 375)
    scales, offsets, bounds = (struct.unpack_from(f"<{n}d", raw, at) for n, at in ((3, 131), (3, 155), (6, 179)))
    extra: list[tuple[str, str]] = []
    place, texts = header, b""
    for _ in range(vlrs):
        user, record, size = struct.unpack_from("<2x16sHH", raw, place)
        body = raw[place + 54 : place + 54 + size]
        if (user.rstrip(b"\0"), record) == (b"LASF_Spec", 4):
            assert set(body[2::192]) == {9}, "data type 9: float"
            extra += [(body[k + 4 : k + 36].rstrip(b"\0").decode(), "<f4") for k in range(0, size, 192)]
        if (user.rstrip(b"\0"), record) == (b"LASF_Spec", 3):
            assert body.endswith(b"\0")
            assert size <= 65_535
        texts += body
        place += 54 + size
    fixed = [("xyz", "<i4", 3), ("intensity", "<u2"), ("returns", "u1"), ("rest", "V15")]
    rows = np.frombuffer(raw, np.dtype([*fixed, *extra]), struct.unpack_from("<Q", raw, 247)[0], data)
    assert rows.dtype.itemsize == length
    assert (rows["returns"] == 0x11).all(), "the first of one"
    assert rows["xyz"].min() >= 0, "the offset lies below all points"
    xyz = rows["xyz"] * scales + offsets
    np.testing.assert_allclose(bounds[1::2], xyz.min(axis=0), atol=1e-7)
    normals = np.stack([rows[f"normal_{axis}"] for axis in "xyz"], 1)
    lengths = {name.removesuffix("_m"): scale * rows[name] for name, _ in extra if name.endswith("_m")}
    plain = {name: rows[name] for name, _ in extra if not name.endswith("_m")}
    return Columns(scale * xyz, rows["intensity"] / 257, normals, lengths | plain, texts.decode("latin-1"))


@pytest.mark.parametrize(
    ("suffix", "read", "unit"),
    [(".ply", of_ply, "unit mm"), (".e57", of_e57, "unit metre"), (".las", of_las, 'UNIT["metre",1.0]')],
)
def test_points_with_all_that_is_known_of_them_are_the_same_in_every_format(
    suffix: str, read: Callable[[Path], Columns], unit: str, surface: FusedCloud, tmp_path: Path
) -> None:
    n = len(surface.grey)
    placed = with_places(surface, np.linspace(0.001, 0.02, n), np.linspace(0.5, 0.1, n))
    off = np.linspace(-1.0, 1.0, n).astype(np.float32)
    off[:5] = np.nan
    for name in ("off", "again"):
        write_surface(tmp_path / f"{name}{suffix}", placed, ABOUT, off)
    assert (tmp_path / f"off{suffix}").read_bytes() == (tmp_path / f"again{suffix}").read_bytes()
    found = read(tmp_path / f"off{suffix}")
    np.testing.assert_allclose(found.xyz, surface.points_mm, atol=UM)
    np.testing.assert_array_equal(found.intensity, surface.grey)
    np.testing.assert_allclose(found.normals, surface.normals, atol=1e-6)
    assert placed.shares is not None
    for name, values in (
        ("sigma", placed.sigma_mm), ("deviation", off), ("sigma_bending", placed.shares.bending_mm),
        ("sigma_place", placed.shares.place_mm), ("sigma_beside", placed.shares.beside_mm),
    ):  # fmt: skip
        np.testing.assert_allclose(found.others[name], values, rtol=1e-6)
    if suffix != ".ply":
        np.testing.assert_array_equal(found.others["views"], placed.views)
    assert unit in found.words
    assert "calibration abc" in found.words


def test_a_mesh_as_ply_and_obj_is_read_elsewhere(cloud: OrganisedCloud, tmp_path: Path) -> None:
    mesh = mesh_of_scan(cloud)
    for suffix in (".ply", ".obj"):
        write_mesh(tmp_path / f"ball{suffix}", mesh, ABOUT)
        read: Any = trimesh.load(tmp_path / f"ball{suffix}", process=False, maintain_order=True)
        np.testing.assert_allclose(read.vertices, mesh.vertices_mm, atol=UM)
        np.testing.assert_array_equal(read.faces, mesh.faces)
        np.testing.assert_allclose(read.visual.vertex_colors[:, 0], mesh.grey, atol=1)
    of_mesh = of_ply(tmp_path / "ball.ply")
    np.testing.assert_allclose(of_mesh.others["sigma"], mesh.sigma_mm, atol=1e-6)
    np.testing.assert_allclose(of_mesh.normals, np.nan_to_num(mesh.normals), atol=1e-6)
    assert "comment Kingfisher scan 000007: unit mm, left camera frame" in of_mesh.words
    assert "water ? 10 ?C" in of_mesh.words, "headers are ASCII"
    assert "unit mm" in (tmp_path / "ball.obj").read_text().splitlines()[0]


def test_stl_is_read_elsewhere_and_its_normals_are_those_of_its_triangles(
    cloud: OrganisedCloud, tmp_path: Path
) -> None:
    mesh = mesh_of_scan(cloud)
    write_mesh(tmp_path / "ball.STL", mesh, ABOUT)
    read: Any = trimesh.load(tmp_path / "ball.STL", process=False)
    np.testing.assert_allclose(read.triangles, mesh.vertices_mm[mesh.faces], atol=UM)
    raw = (tmp_path / "ball.STL").read_bytes()
    assert raw[:5] != b"solid", "which would be taken for a text"
    assert b"unit mm" in raw[:80]
    stored = np.frombuffer(raw[84:], np.dtype([("n", "<f4", 3), ("rest", "V38")]))["n"]
    np.testing.assert_allclose(stored, read.face_normals, atol=1e-3)
    corners = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], np.float32)
    flat = Mesh(corners, np.array([[0, 1, 2]], np.int32), corners, corners[:, 0], np.zeros(3, np.uint8))
    write_mesh(tmp_path / "flat.stl", flat, replace(ABOUT, title="t" * 100))
    raw = (tmp_path / "flat.stl").read_bytes()
    assert (raw[:80], raw[84:96]) == (b"Kingfisher " + b"t" * 69, bytes(12)), "a triangle without area has no normal"


def test_a_line_has_at_most_two_hundred_characters_and_a_mark_two_thousand() -> None:
    lines = About("t", "f", ("n" * 300,), ("m" * 2001, "m" * 1999)).lines("mm")
    assert [len(line) for line in lines] == [len("t: unit mm, f"), 2000, 1999, 200]


def test_a_cloud_without_scale_has_its_unit_in_every_file(cloud: OrganisedCloud, tmp_path: Path) -> None:
    """Numbers are as they are, also where a format has metres, and no name says mm or m."""
    for suffix in (".ply", ".las", ".e57", ".npz"):
        write_scan(tmp_path / f"ball{suffix}", cloud, replace(ABOUT, unit="baselines"))
    points, sigma = cloud.points_mm[cloud.mask], cloud.sigma_mm[cloud.mask]
    las, e57 = of_las(tmp_path / "ball.las", "baselines"), of_e57(tmp_path / "ball.e57", 1.0)
    for found in (las, e57):
        np.testing.assert_allclose(found.xyz, points, atol=1e-4)
    np.testing.assert_allclose(las.others["sigma_baselines"], sigma, rtol=1e-6)
    assert 'UNIT["baselines",1.0]' in las.words
    assert "unit baselines" in e57.words
    header = (tmp_path / "ball.ply").read_bytes().partition(b"end_header")[0].decode()
    for said in ("unit baselines", "deviation in baselines", "float ray_gap_baselines"):
        assert said in header
    with np.load(tmp_path / "ball.npz") as archive:
        assert json.loads(str(archive["about"]))["unit"] == "baselines"
        np.testing.assert_array_equal(archive["z_baselines"], cloud.points_mm[..., 2])


def test_what_spoils_a_cloud_is_said_in_the_same_words_in_every_file(cloud: OrganisedCloud, tmp_path: Path) -> None:
    """Whoever looks for ``unchecked: `` finds it, whatever the suffix, and however long the line is."""
    mark = f"unchecked: one direction only{', and more' * 30}"
    spoilt = replace(ABOUT, marks=(mark, "wrong: a start"))
    for suffix in (".ply", ".las", ".e57", ".npz"):
        write_scan(tmp_path / f"ball{suffix}", cloud, spoilt)
    write_mesh(tmp_path / "ball.obj", mesh_of_scan(cloud), spoilt)
    header = (tmp_path / "ball.ply").read_bytes().partition(b"end_header")[0].decode().splitlines()
    assert {f"comment {mark}", "comment wrong: a start", "comment Kingfisher calibration abc"} <= set(header)
    assert {mark, "wrong: a start", "calibration abc"} <= set(re.split("[\\n\\0]", of_las(tmp_path / "ball.las").words))
    write_scan(tmp_path / "many.las", cloud, replace(ABOUT, notes=("n" * 199,) * 400))
    assert of_las(tmp_path / "many.las").words.count("n" * 199) > 300
    assert f"; {mark}; wrong: a start; " in read_e57(tmp_path / "ball.e57").description
    with np.load(tmp_path / "ball.npz") as archive:
        assert json.loads(str(archive["about"]))["notes"] == [mark, "wrong: a start", *ABOUT.notes]
    assert {f"# {mark}", "# wrong: a start"} <= set((tmp_path / "ball.obj").read_text().splitlines()[:10])


POSES = tuple(Rotation.from_euler("xyz", angles, degrees=True).as_matrix() for angles in ((0, 0, 0), (20, -35, 170)))
SHIFTS = np.zeros(3), np.array([250.0, -40.0, 12.5])


def placed_twice(cloud: OrganisedCloud) -> list[PlacedGrid]:
    return [
        PlacedGrid(f"00000{k}", cloud, turn, shift, np.full((6, 6), k + 0.5), np.full(3, k + 0.25))
        for k, (turn, shift) in enumerate(zip(POSES, SHIFTS, strict=True))
    ]


def test_e57_of_an_objects_scans_puts_each_where_it_lies(cloud: OrganisedCloud, tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57")
    write_placed(tmp_path / "scans.e57", iter(placed_twice(cloud)), ABOUT)
    file = pye57.E57(str(tmp_path / "scans.e57"))
    assert file.scan_count == 2
    points_mm = cloud.points_mm[cloud.mask].astype(np.float64)
    for k, (turn, shift) in enumerate(zip(POSES, SHIFTS, strict=True)):
        own, placed = (file.read_scan(k, transform=moved, ignore_missing_fields=True) for moved in (False, True))
        in_frames = [1000.0 * np.stack([one[f"cartesian{axis}"] for axis in "XYZ"], 1) for one in (own, placed)]
        np.testing.assert_allclose(in_frames[0], points_mm, atol=UM)
        np.testing.assert_allclose(in_frames[1], points_mm @ turn.T + shift, atol=UM)
        assert file.get_header(k)["name"].value() == f"00000{k}"
        limits = file.get_header(k)["intensityLimits"]
        assert [limits[f"intensity{end}"].value() for end in ("Minimum", "Maximum")] == [0.0, 255.0]
    guids = {file.get_header(k)["guid"].value() for k in range(2)} | {file.root["guid"].value()}
    assert len(guids) == 3
    write_placed(tmp_path / "again.e57", [replace(one, rotation=POSES[1]) for one in placed_twice(cloud)], ABOUT)
    again = pye57.E57(str(tmp_path / "again.e57"))
    assert again.root["guid"].value() not in guids, "the same points lie elsewhere"


def test_the_archive_of_an_objects_scans_has_each_grid_and_its_place(cloud: OrganisedCloud, tmp_path: Path) -> None:
    write_placed(tmp_path / "scans.npz", iter(placed_twice(cloud)), ABOUT)
    assert {one.compress_type for one in zipfile.ZipFile(tmp_path / "scans.npz").infolist()} == {zipfile.ZIP_DEFLATED}
    with np.load(tmp_path / "scans.npz") as read:
        assert read["scans"].tolist() == ["000000", "000001"]
        assert json.loads(str(read["about"])) == {
            "title": "scan 000007", "frame": CAMERA_FRAME, "unit": "mm", "notes": list(ABOUT.notes),
        }  # fmt: skip
        for one in placed_twice(cloud):
            found = {name: read[f"{one.name}/{name}"] for name in ("rotation", "translation_mm", "middle_mm")}
            np.testing.assert_array_equal(found["rotation"], one.rotation)
            np.testing.assert_array_equal(found["translation_mm"], one.translation_mm)
            np.testing.assert_array_equal(found["middle_mm"], one.middle_mm)
            np.testing.assert_array_equal(read[f"{one.name}/place_covariance"], one.covariance)
            np.testing.assert_array_equal(read[f"{one.name}/z_mm"], cloud.points_mm[..., 2])
        assert len(read.files) == 2 + 2 * (4 + 8)
    with pytest.raises(ExportError, match=r"the scans of an object is written as \.npz, \.e57, not as \.ply"):
        write_placed(tmp_path / "scans.ply", [], ABOUT)


def test_site_coordinates_are_held_or_refused(surface: FusedCloud, tmp_path: Path) -> None:
    laspy = pytest.importorskip("laspy")
    site = np.array([5.0e8, 5.4e9, 0.0])
    write_surface(tmp_path / "far.las", surface, ABOUT, origin_mm=site)
    read = laspy.read(tmp_path / "far.las")
    np.testing.assert_allclose(1000.0 * np.asarray(read.xyz) - site, surface.points_mm, atol=2.0 * UM)
    assert len(np.unique(np.asarray(read.x))) > 100
    with pytest.raises(ExportError, match=r"steps of 512 mm; write \.e57 or \.las"):
        write_surface(tmp_path / "far.ply", surface, ABOUT, origin_mm=site)
    assert not (tmp_path / "far.ply").exists()
    write_surface(tmp_path / "near.ply", surface, ABOUT, origin_mm=np.array([5.1e5, 0.0, 0.0]))
    near: Any = trimesh.load(tmp_path / "near.ply", process=False)
    np.testing.assert_allclose(near.vertices[:, 0] - 5.1e5, surface.points_mm[:, 0], atol=0.02)
    np.testing.assert_array_equal(near.colors[:, 2], surface.grey)
    with pytest.raises(ExportError, match=r"steps of 0\.0625 mm"):
        write_surface(tmp_path / "far.ply", surface, ABOUT, origin_mm=np.array([5.3e5, 0.0, 0.0]))


@pytest.mark.parametrize(("width_mm", "step_m"), [(0.0, 1e-7), (2.14e5, 1e-7), (2.15e5, 1e-6)])
def test_las_is_as_coarse_as_its_width_asks_for(
    width_mm: float, step_m: float, surface: FusedCloud, tmp_path: Path
) -> None:
    laspy = pytest.importorskip("laspy")
    wide = replace(surface, points_mm=np.zeros_like(surface.points_mm))
    wide.points_mm[0] = (width_mm, 0.0, 0.0)
    write_surface(tmp_path / "wide.las", wide, ABOUT)
    read = laspy.read(tmp_path / "wide.las")
    np.testing.assert_allclose(read.header.scales, step_m)
    np.testing.assert_allclose(1000.0 * np.asarray(read.xyz), wide.points_mm, atol=1000.0 * step_m)
    wide.points_mm[1] = np.nan
    with pytest.raises(ExportError, match="no number"):
        write_surface(tmp_path / "none.las", wide, ABOUT)


def test_the_archive_keeps_the_grid(cloud: OrganisedCloud, tmp_path: Path) -> None:
    write_scan(tmp_path / "ball.npz", cloud, ABOUT)
    with np.load(tmp_path / "ball.npz") as read:
        found = {name: read[name] for name in read.files}
    assert json.loads(str(found.pop("about"))) == {
        "title": "scan 000007", "frame": CAMERA_FRAME, "unit": "mm", "notes": list(ABOUT.notes),
    }  # fmt: skip
    np.testing.assert_array_equal(np.stack([found.pop(f"{axis}_mm") for axis in "xyz"], -1), cloud.points_mm)
    assert set(found) == {"sigma_mm", "ray_gap_mm", "modulation_dn", "grey", "mask"}
    for name, values in found.items():
        np.testing.assert_array_equal(values, getattr(cloud, name), err_msg=name)


# ---------------------------------------------------------------------------------------- what is refused


@pytest.mark.parametrize("name", ["ball.xyz", "ball", "ball.stl"])
def test_other_suffixes_are_refused_with_those_that_are_allowed(
    name: str, cloud: OrganisedCloud, tmp_path: Path
) -> None:
    with pytest.raises(ExportError, match=r"a scan is written as \.ply, \.e57, \.las, \.npz, not as"):
        write_scan(tmp_path / name, cloud, ABOUT)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("suffix", "package"), [(".E57", "pye57"), (".html", "plotly"), (".ply", "")])
def test_a_library_that_is_absent_is_told_before_minutes_of_work(
    suffix: str, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    require_library(Path(f"ball{suffix}"))
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(MissingLibraryError, match=f"needs {package}: pip") if package else nullcontext():
        require_library(Path(f"ball{suffix}"))


@pytest.mark.parametrize("suffix", [".ply", ".e57", ".las", ".npz"])
def test_a_file_that_cannot_be_written_leaves_the_one_of_before(
    suffix: str, cloud: OrganisedCloud, tmp_path: Path
) -> None:
    path = tmp_path / f"ball{suffix}"
    path.write_bytes(b"of before")
    nothing = replace(cloud, points_mm=np.full_like(cloud.points_mm, np.nan))
    if suffix == ".e57":
        with pytest.raises(ValueError, match="at least one point"):
            write_scan(path, nothing, ABOUT)
        assert path.read_bytes() == b"of before"
    else:
        write_scan(path, nothing, ABOUT)
        assert path.read_bytes() != b"of before"
    assert [one.name for one in tmp_path.iterdir()] == [path.name], "no draft is left"
