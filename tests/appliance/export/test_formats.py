"""Every file that leaves the instrument is read back, by a reader that did not write it, to a micrometre."""

from __future__ import annotations

import ast
import importlib.util
import json
import struct
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from appliance.export.content import CAMERA_FRAME, About, points_of_surface
from appliance.export.files import write_mesh, write_scan, write_surface
from appliance.export.placed import PlacedGrid, write_placed
from appliance.export.ply import encode_surface
from appliance.export.suffixes import ExportError, require_library
from appliance.reconstruct.organised import OrganisedCloud
from appliance.surface.fusion import FusedCloud, PlacedScan, fuse, with_places
from appliance.surface.libraries import MissingLibraryError
from appliance.surface.mesh import Mesh, mesh_of_scan
from appliance.surface.normals import normals
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


def test_a_mesh_as_ply_has_faces_normals_grey_and_sigma(cloud: OrganisedCloud, tmp_path: Path) -> None:
    mesh = mesh_of_scan(cloud)
    write_mesh(tmp_path / "ball.ply", mesh, ABOUT)
    read: Any = trimesh.load(tmp_path / "ball.ply", process=False)
    np.testing.assert_allclose(read.vertices, mesh.vertices_mm, atol=UM)
    np.testing.assert_array_equal(read.faces, mesh.faces)
    np.testing.assert_array_equal(read.visual.vertex_colors[:, 0], mesh.grey)
    data = read.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_allclose(data["sigma"], mesh.sigma_mm, atol=1e-6)
    np.testing.assert_allclose(
        np.stack([data["nx"], data["ny"], data["nz"]], 1), np.nan_to_num(mesh.normals), atol=1e-6
    )
    head = (tmp_path / "ball.ply").read_bytes()[:600].decode("ascii", "replace")
    assert "comment Kingfisher scan 000007: unit mm, left camera frame" in head
    assert "water ? 10 ?C" in head, "headers are ASCII"


def test_points_as_ply_are_read_elsewhere(surface: FusedCloud, tmp_path: Path) -> None:
    write_surface(tmp_path / "ball.ply", surface, ABOUT)
    read: Any = trimesh.load(tmp_path / "ball.ply", process=False)
    np.testing.assert_allclose(read.vertices, surface.points_mm, atol=UM)
    np.testing.assert_array_equal(read.colors[:, 2], surface.grey)


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


def test_an_stl_triangle_without_area_has_no_normal(tmp_path: Path) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], np.float32)
    flat = Mesh(corners, np.array([[0, 1, 2]], np.int32), corners, corners[:, 0], np.zeros(3, np.uint8))
    write_mesh(tmp_path / "flat.stl", flat, replace(ABOUT, title="t" * 100))
    raw = (tmp_path / "flat.stl").read_bytes()
    assert raw[:80] == b"Kingfisher " + b"t" * 69
    assert raw[84:96] == bytes(12)


def test_a_line_has_at_most_two_hundred_characters_and_a_mark_two_thousand() -> None:
    lines = About("t", "f", ("n" * 300,), ("m" * 2001, "m" * 1999)).lines("mm")
    assert [len(line) for line in lines] == [len("t: unit mm, f"), 2000, 1999, 200]


def test_obj_is_read_elsewhere(cloud: OrganisedCloud, tmp_path: Path) -> None:
    mesh = mesh_of_scan(cloud)
    write_mesh(tmp_path / "ball.obj", mesh, ABOUT)
    read: Any = trimesh.load(tmp_path / "ball.obj", process=False, maintain_order=True)
    np.testing.assert_allclose(read.vertices, mesh.vertices_mm, atol=UM)
    np.testing.assert_array_equal(read.faces, mesh.faces)
    np.testing.assert_allclose(read.visual.vertex_colors[:, 1], mesh.grey, atol=1)
    assert "unit mm" in (tmp_path / "ball.obj").read_text().splitlines()[0]


def test_e57_is_in_metres_and_says_so(cloud: OrganisedCloud, tmp_path: Path) -> None:
    write_scan(tmp_path / "ball.e57", cloud, ABOUT)
    read = read_e57(tmp_path / "ball.e57")
    points = np.stack([read.columns[f"cartesian{axis}"] for axis in "XYZ"], 1)
    np.testing.assert_allclose(1000.0 * points, cloud.points_mm[cloud.mask], atol=UM)
    np.testing.assert_array_equal(read.columns["intensity"], cloud.grey[cloud.mask])
    np.testing.assert_allclose(1000.0 * read.columns["kf:sigma"], cloud.sigma_mm[cloud.mask], rtol=1e-6)
    found = np.stack([read.columns[f"nor:normal{axis}"] for axis in "XYZ"], 1)
    np.testing.assert_allclose(found, np.nan_to_num(normals(cloud)[cloud.mask]), atol=1e-6)
    assert read.namespaces["nor"] == "http://www.libe57.org/E57_NOR_surface_normals.txt"
    assert (read.name, "unit metre" in read.description) == ("scan 000007", True)
    assert read.bounds_m["xMinimum"] == pytest.approx(points[:, 0].min())
    assert read.bounds_m["zMaximum"] == pytest.approx(points[:, 2].max())


def test_the_same_points_give_the_same_e57_file(cloud: OrganisedCloud, tmp_path: Path) -> None:
    for name in ("one.e57", "two.e57"):
        write_scan(tmp_path / name, cloud, ABOUT)
    assert (tmp_path / "one.e57").read_bytes() == (tmp_path / "two.e57").read_bytes()


def las_columns(raw: bytes, unit: str = "metre") -> dict[str, NDArray[Any]]:
    """Points of an LAS 1.4 file of point format 6, from the tables of ASPRS' specification."""
    assert raw[:4] == b"LASF"
    assert (raw[24], raw[25]) == (1, 4)
    assert raw[26:58].rstrip(b"\0") == f"Kingfisher, unit {unit}".encode()
    assert raw[58:90].rstrip(b"\0") == b"kingfisher"
    assert raw[6] & 16, "its coordinate system is in words"
    assert raw[90:94] == bytes(4), "no date, else the same points would not give the same file"
    header, data, vlrs = struct.unpack_from("<HII", raw, 94)
    kind, length = struct.unpack_from("<BH", raw, 104)
    assert (kind, header) == (6, 375)
    scales, offsets = struct.unpack_from("<3d", raw, 131), struct.unpack_from("<3d", raw, 155)
    bounds = struct.unpack_from("<6d", raw, 179)
    (count,) = struct.unpack_from("<Q", raw, 247)
    extra: list[tuple[str, str]] = []
    place, texts, area = header, b"", b""
    for _ in range(vlrs):
        user, record, size = struct.unpack_from("<2x16sHH", raw, place)
        body = raw[place + 54 : place + 54 + size]
        if (user.rstrip(b"\0"), record) == (b"LASF_Spec", 4):
            for k in range(0, size, 192):
                assert body[k + 2] == 9, "data type 9: float"
                extra.append((body[k + 4 : k + 36].rstrip(b"\0").decode(), "<f4"))
        if (user.rstrip(b"\0"), record) == (b"LASF_Spec", 3):
            area = body
        texts += body
        place += 54 + size
    fixed = [("x", "<i4"), ("y", "<i4"), ("z", "<i4"), ("intensity", "<u2"), ("returns", "u1"), ("rest", "V15")]
    rows = np.frombuffer(raw, np.dtype([*fixed, *extra]), count, data)
    assert rows.dtype.itemsize == length
    assert min(rows[axis].min() for axis in "xyz") >= 0, "the offset lies below all points"
    out = {name: rows[name] for name in ("intensity", "returns", *(name for name, _ in extra))}
    xyz = np.stack([rows[axis] * scales[k] + offsets[k] for k, axis in enumerate("xyz")], 1)
    np.testing.assert_allclose([bounds[1], bounds[3], bounds[5]], xyz.min(axis=0), atol=1e-7)
    return {
        **out,
        "xyz": xyz,
        "texts": np.frombuffer(texts, np.uint8),
        "text area": np.frombuffer(area, np.uint8),
        "scales": np.array(scales),
    }


def test_las_is_in_metres_and_a_micrometre_survives(surface: FusedCloud, tmp_path: Path) -> None:
    write_surface(tmp_path / "ball.las", surface, ABOUT)
    read = las_columns((tmp_path / "ball.las").read_bytes())
    np.testing.assert_allclose(1000.0 * read["xyz"], surface.points_mm, atol=0.2 * UM)
    assert (read["scales"] <= 1e-6).all()
    np.testing.assert_array_equal(read["intensity"], surface.grey.astype(int) * 257)
    assert (read["returns"] == 0x11).all(), "the first of one"
    np.testing.assert_allclose(1000.0 * read["sigma_m"], surface.sigma_mm, rtol=1e-6)
    np.testing.assert_allclose(read["normal_z"], surface.normals[:, 2], atol=1e-6)
    np.testing.assert_array_equal(read["views"], surface.views)
    texts = read["texts"].tobytes()
    assert b'UNIT["metre",1.0]' in texts
    assert b"standard deviation, metre" in texts


def test_a_cloud_without_scale_has_its_unit_in_every_file(cloud: OrganisedCloud, tmp_path: Path) -> None:
    """Numbers are as they are, also where a format has metres, and no name says mm or m."""
    unscaled = replace(ABOUT, unit="baselines")
    for suffix in (".ply", ".las", ".e57", ".npz"):
        write_scan(tmp_path / f"ball{suffix}", cloud, unscaled)
    points, sigma = cloud.points_mm[cloud.mask], cloud.sigma_mm[cloud.mask]
    las, e57 = las_columns((tmp_path / "ball.las").read_bytes(), "baselines"), read_e57(tmp_path / "ball.e57")
    np.testing.assert_allclose(las["xyz"], points, atol=1e-5)
    np.testing.assert_allclose(las["sigma_baselines"], sigma, rtol=1e-6)
    assert b'UNIT["baselines",1.0]' in las["texts"].tobytes()
    np.testing.assert_allclose(e57.columns["cartesianZ"], points[:, 2], atol=1e-4)
    assert "unit baselines" in e57.description
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
    text_area = las_columns((tmp_path / "ball.las").read_bytes())["text area"].tobytes()
    assert text_area.endswith(b"\0")
    assert {mark, "wrong: a start", "calibration abc"} <= set(text_area[:-1].decode().split("\n"))
    many = replace(ABOUT, notes=("n" * 199,) * 400)
    write_scan(tmp_path / "many.las", cloud, many)
    assert len(las_columns((tmp_path / "many.las").read_bytes())["text area"]) == 65_535
    assert f"; {mark}; wrong: a start; " in read_e57(tmp_path / "ball.e57").description
    with np.load(tmp_path / "ball.npz") as archive:
        assert json.loads(str(archive["about"]))["notes"] == [mark, "wrong: a start", *ABOUT.notes]
    assert {f"# {mark}", "# wrong: a start"} <= set((tmp_path / "ball.obj").read_text().splitlines()[:10])


def test_deviations_and_shares_of_sigma_are_columns_of_every_format_of_points(
    surface: FusedCloud, tmp_path: Path
) -> None:
    n = len(surface.grey)
    placed = with_places(surface, np.linspace(0.001, 0.02, n), np.linspace(0.5, 0.1, n))
    off = np.linspace(-1.0, 1.0, n).astype(np.float32)
    off[:5] = np.nan
    for suffix in (".ply", ".e57", ".las"):
        write_surface(tmp_path / f"off{suffix}", placed, ABOUT, off)
    with (tmp_path / "off.ply").open("rb") as opened:
        of_ply = trimesh.load(opened, file_type="ply").metadata["_ply_raw"]["vertex"]["data"]
    of_las = las_columns((tmp_path / "off.las").read_bytes())
    of_e57 = read_e57(tmp_path / "off.e57").columns
    assert placed.shares is not None
    for name, values in (
        ("deviation", off), ("sigma_bending", placed.shares.bending_mm), ("sigma_place", placed.shares.place_mm),
        ("sigma_beside", placed.shares.beside_mm),
    ):  # fmt: skip
        np.testing.assert_allclose(of_ply[f"{name}_mm"], values)
        np.testing.assert_allclose(1000.0 * of_las[f"{name}_m"], values, rtol=1e-6)
        np.testing.assert_allclose(1000.0 * of_e57[f"kf:{name}"], values, rtol=1e-6)
    np.testing.assert_allclose(1000.0 * of_e57["kf:sigma"], placed.sigma_mm, rtol=1e-6)
    np.testing.assert_array_equal(of_e57["kf:views"], placed.views)


def test_e57_is_read_whole_by_the_library_that_most_programs_use(surface: FusedCloud, tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57")
    site = np.array([5.0e8, 5.4e9, -2000.0])
    write_surface(tmp_path / "far.e57", surface, ABOUT, origin_mm=site)
    read = pye57.E57(str(tmp_path / "far.e57")).read_scan(0)
    found = np.stack([read[f"cartesian{axis}"] for axis in "XYZ"], 1)
    np.testing.assert_allclose(1000.0 * found - site, surface.points_mm, atol=2.0 * UM)


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
    with pytest.raises(ExportError, match=r"steps of 0\.0625 mm"):
        write_surface(tmp_path / "far.ply", surface, ABOUT, origin_mm=np.array([5.3e5, 0.0, 0.0]))
    none = replace(
        points_of_surface(surface, site),
        points_mm=np.zeros((0, 3), np.float32),
        grey=np.zeros(0, np.uint8),
        sigma_mm=np.zeros(0, np.float32),
        normals=np.zeros((0, 3), np.float32),
        more={},
    )
    assert b"element vertex 0\n" in next(encode_surface(none, ABOUT))


@pytest.mark.parametrize(("width_mm", "step_m"), [(0.0, 1e-7), (2.14e5, 1e-7), (2.15e5, 1e-6), (2.15e6, 1e-5)])
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
    found = {}
    with zipfile.ZipFile(tmp_path / "ball.npz") as archive:
        for name in archive.namelist():
            raw = archive.read(name)
            # The head of an .npy file of version 1: magic, two bytes, its length, a Python dictionary.
            (long,) = struct.unpack_from("<H", raw, 8)
            head = ast.literal_eval(raw[10 : 10 + long].decode())
            flat, shape = np.frombuffer(raw[10 + long :], head["descr"]), head["shape"]
            # Column by column, where an array was stored so.
            found[name.removesuffix(".npy")] = (
                flat.reshape(shape[::-1]).T if head["fortran_order"] else flat.reshape(shape)
            )
    assert json.loads(str(found.pop("about"))) == {
        "title": "scan 000007", "frame": CAMERA_FRAME, "unit": "mm", "notes": list(ABOUT.notes),
    }  # fmt: skip
    assert set(found) == {"x_mm", "y_mm", "z_mm", "sigma_mm", "ray_gap_mm", "modulation_dn", "grey", "mask"}
    assert {one.shape for one in found.values()} == {(100, 120)}
    np.testing.assert_array_equal(found["mask"], cloud.mask)
    np.testing.assert_array_equal(np.stack([found[f"{axis}_mm"] for axis in "xyz"], -1), cloud.points_mm)
    np.testing.assert_array_equal(found["sigma_mm"], cloud.sigma_mm)
    np.testing.assert_array_equal(found["grey"], cloud.grey)
    np.testing.assert_array_equal(found["modulation_dn"], cloud.modulation_dn)
    np.testing.assert_array_equal(found["ray_gap_mm"], cloud.ray_gap_mm)


# ---------------------------------------------------------------------------------------- what is refused


@pytest.mark.parametrize("name", ["ball.xyz", "ball", "ball.ply.gz", "ball.stl"])
def test_other_suffixes_are_refused_with_those_that_are_allowed(
    name: str, cloud: OrganisedCloud, tmp_path: Path
) -> None:
    with pytest.raises(ExportError, match=r"a scan is written as \.ply, \.e57, \.las, \.npz, not as"):
        write_scan(tmp_path / name, cloud, ABOUT)
    assert not list(tmp_path.iterdir())


def test_a_library_that_is_absent_is_named_with_the_remedy(
    cloud: OrganisedCloud, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = importlib.import_module

    def absent(name: str) -> Any:
        if name in ("pye57", "laspy"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name)

    monkeypatch.setattr(importlib, "import_module", absent)
    for suffix, package in ((".e57", "pye57"), (".las", "laspy")):
        with pytest.raises(MissingLibraryError, match=rf"needs {package}: pip install 'kingfisher-3d\[desk\]'"):
            write_scan(tmp_path / f"ball{suffix}", cloud, ABOUT)
    assert not list(tmp_path.iterdir()), "nothing half made is left"


@pytest.mark.parametrize(
    ("suffix", "package"), [(".E57", "pye57"), (".las", "laspy"), (".html", "plotly"), (".ply", "")]
)
def test_a_library_that_is_absent_is_told_before_minutes_of_work(
    suffix: str, package: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    require_library(Path(f"ball{suffix}"))
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    if package:
        with pytest.raises(MissingLibraryError, match=f"needs {package}: pip install"):
            require_library(Path(f"ball{suffix}"))
    else:
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
