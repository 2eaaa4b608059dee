"""Every file that leaves the instrument is read back to a micrometre, also by readers that did not write it."""

from __future__ import annotations

import importlib.util
import json
import re
import zipfile
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from appliance.base.libraries import MissingLibraryError
from appliance.desk.export.content import CAMERA_FRAME, Metadata
from appliance.desk.export.files import write_mesh, write_scan, write_scans, write_surface
from appliance.desk.export.formats import ExportError, require_library
from appliance.desk.surface.fusion import FusedCloud, PlacedScan, fuse, with_places
from appliance.desk.surface.mesh import Mesh, mesh_of_scan
from appliance.measure.points.organised import OrganisedCloud
from tests.support.e57 import read_e57
from tests.support.solids import Ball, looking, seen

UM = 0.001
ABOUT = Metadata("scan 000007", CAMERA_FRAME, ("calibration abc", "water – 10 °C"))
ABOUT_AS_JSON = {"title": "scan 000007", "frame": CAMERA_FRAME, "unit": "mm", "notes": list(ABOUT.notes)}


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
    read = laspy.read(path)
    header, scale = read.header, 1000.0 if unit == "metre" else 1.0
    assert (str(header.version), header.point_format.id, header.global_encoding.wkt) == ("1.4", 6, True)
    assert (header.system_identifier, header.generating_software) == (f"Kingfisher, unit {unit}", "kingfisher")
    assert header.creation_date is None, "else the same points would not give the same file"
    assert (read.return_number == 1).all()
    assert (read.number_of_returns == 1).all()
    assert read.X.min() >= 0, "the offset lies below all points"
    xyz = np.asarray(read.xyz)
    np.testing.assert_allclose([header.mins, header.maxs], [xyz.min(axis=0), xyz.max(axis=0)], atol=1e-7)
    extra = {name: np.asarray(read[name]) for name in header.point_format.extra_dimension_names}
    assert {values.dtype for values in extra.values()} == {np.dtype("f4")}
    normals = np.stack([extra[f"normal_{axis}"] for axis in "xyz"], 1)
    others = {name.removesuffix("_m"): (scale if name.endswith("_m") else 1.0) * one for name, one in extra.items()}
    words = b"\n".join(vlr.record_data_bytes() for vlr in header.vlrs).decode("latin-1")
    return Columns(scale * xyz, np.asarray(read.intensity) / 257, normals, others, words)


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


def test_stl_is_read_elsewhere_with_the_normals_of_its_triangles(cloud: OrganisedCloud, tmp_path: Path) -> None:
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
    lines = Metadata("t", "f", ("n" * 300,), ("m" * 2001, "m" * 1999)).lines("mm")
    assert [len(line) for line in lines] == [len("t: unit mm, f"), 2000, 1999, 200]
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


def placed_twice(cloud: OrganisedCloud) -> list[PlacedScan]:
    return [
        PlacedScan(
            cloud,
            turn,
            shift,
            name=f"00000{k}",
            covariance=np.full((6, 6), k + 0.5),
            middle_mm=np.full(3, k + 0.25),
        )
        for k, (turn, shift) in enumerate(zip(POSES, SHIFTS, strict=True))
    ]


def test_e57_of_an_objects_scans_puts_each_where_it_lies(cloud: OrganisedCloud, tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57")
    write_scans(tmp_path / "scans.e57", iter(placed_twice(cloud)), ABOUT)
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
    write_scans(tmp_path / "again.e57", [replace(one, rotation=POSES[1]) for one in placed_twice(cloud)], ABOUT)
    again = pye57.E57(str(tmp_path / "again.e57"))
    assert again.root["guid"].value() not in guids, "the same points lie elsewhere"


def test_the_archive_of_an_objects_scans_has_each_grid_and_its_place(cloud: OrganisedCloud, tmp_path: Path) -> None:
    write_scans(tmp_path / "scans.npz", iter(placed_twice(cloud)), ABOUT)
    assert {one.compress_type for one in zipfile.ZipFile(tmp_path / "scans.npz").infolist()} == {zipfile.ZIP_DEFLATED}
    with np.load(tmp_path / "scans.npz") as read:
        assert read["scans"].tolist() == ["000000", "000001"]
        assert json.loads(str(read["about"])) == ABOUT_AS_JSON
        for one in placed_twice(cloud):
            for name in ("rotation", "translation_mm", "middle_mm"):
                np.testing.assert_array_equal(read[f"{one.name}/{name}"], getattr(one, name))
            np.testing.assert_array_equal(read[f"{one.name}/place_covariance"], one.covariance)
            np.testing.assert_array_equal(read[f"{one.name}/z_mm"], cloud.points_mm[..., 2])
        assert len(read.files) == 2 + 2 * (4 + 8)
    with pytest.raises(ExportError, match=r"the scans of an object is written as \.e57, \.npz, not as \.ply"):
        write_scans(tmp_path / "scans.ply", [], ABOUT)


def test_site_coordinates_are_held_or_refused(surface: FusedCloud, tmp_path: Path) -> None:
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
def test_las_is_as_coarse_as_it_is_wide(width_mm: float, step_m: float, surface: FusedCloud, tmp_path: Path) -> None:
    wide = replace(surface, points_mm=np.zeros_like(surface.points_mm))
    wide.points_mm[0] = (width_mm, 0.0, 0.0)
    write_surface(tmp_path / "wide.las", wide, ABOUT)
    read = laspy.read(tmp_path / "wide.las")
    np.testing.assert_allclose(read.header.scales, step_m)
    np.testing.assert_allclose(1000.0 * np.asarray(read.xyz), wide.points_mm, atol=1000.0 * step_m)
    wide.points_mm[1] = np.nan
    with pytest.raises(ExportError, match="not finite"):
        write_surface(tmp_path / "none.las", wide, ABOUT)


def test_the_archive_keeps_the_grid(cloud: OrganisedCloud, tmp_path: Path) -> None:
    write_scan(tmp_path / "ball.npz", cloud, ABOUT)
    with np.load(tmp_path / "ball.npz") as read:
        found = {name: read[name] for name in read.files}
    assert json.loads(str(found.pop("about"))) == ABOUT_AS_JSON
    np.testing.assert_array_equal(np.stack([found.pop(f"{axis}_mm") for axis in "xyz"], -1), cloud.points_mm)
    assert set(found) == {"sigma_mm", "ray_gap_mm", "modulation_dn", "grey", "mask"}
    for name, values in found.items():
        np.testing.assert_array_equal(values, getattr(cloud, name), err_msg=name)


def test_other_suffixes_and_absent_libraries_are_told_before_minutes_of_work(
    cloud: OrganisedCloud, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("ball.xyz", "ball", "ball.stl"):
        with pytest.raises(ExportError, match=r"a scan is written as \.ply, \.e57, \.las, \.npz, not as"):
            write_scan(tmp_path / name, cloud, ABOUT)
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    for suffix, package in ((".E57", "pye57"), (".html", "plotly")):
        with pytest.raises(MissingLibraryError, match=f"needs {package}: pip"):
            require_library(Path(f"ball{suffix}"))
    require_library(Path("ball.ply"))
    monkeypatch.undo()
    require_library(Path("ball.e57"))


def test_a_file_that_cannot_be_written_leaves_the_one_of_before(cloud: OrganisedCloud, tmp_path: Path) -> None:
    nothing = replace(cloud, points_mm=np.full_like(cloud.points_mm, np.nan))
    for suffix in (".ply", ".e57", ".las", ".npz"):
        path = tmp_path / f"ball{suffix}"
        path.write_bytes(b"of before")
        with pytest.raises(ValueError, match="at least one point") if suffix == ".e57" else nullcontext():
            write_scan(path, nothing, ABOUT)
        assert (path.read_bytes() == b"of before") == (suffix == ".e57")
    assert len(list(tmp_path.iterdir())) == 4, "no draft is left"


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
