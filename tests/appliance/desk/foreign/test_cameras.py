"""Cameras of others: the same rig from every program's files and from words in the description; and what is wrong is named."""

from __future__ import annotations

import json
import struct
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.io import savemat

from appliance.desk.foreign.camera_files import cameras_in, numbers_in
from appliance.desk.foreign.cameras import ForeignRig, lens_of, read_rig
from appliance.desk.foreign.description import parse_description
from appliance.desk.foreign.problem import ForeignError
from appliance.measure.calibration.file import IN_AIR, Calibration, encode_calibration
from appliance.measure.light.water import Water

SIZES = {"left": (640, 480), "right": (640, 480)}
M1 = np.array([[800.0, 0, 320], [0, 810, 240], [0, 0, 1]])
M2 = np.array([[790.0, 0, 310], [0, 795, 250], [0, 0, 1]])
D1, D2 = np.array([[-0.1, 0.05, 0.001, -0.002, 0.0]]), np.array([[-0.08, 0.02, 0.0, 0.0, 0.0]])
R = np.asarray(cv2.Rodrigues(np.array([0.01, -0.2, 0.03]))[0])
T = np.array([[-100.0], [2.0], [10.0]])
OPENCV = {"M1": M1, "D1": D1, "M2": M2, "D2": D2, "R": R, "T": T}
BOTH = (("left", M1, D1), ("right", M2, D2))
WORLD_R, WORLD_T = np.asarray(cv2.Rodrigues(np.array([0.2, 0.1, -0.3]))[0]), np.array([[20.0], [-30.0], [900.0]])
HEAD = """
[images]
left = "l*"
right = "r*"
order = "gray-x*8"
[projector]
width_px = 640
height_px = 480
[x]
stripe_px = 4
"""


ALONE = HEAD.replace('right = "r*"\n', "")  # a projector takes the right camera's place


def rig(folder: Path, cameras: str, more: str = "", head: str = HEAD) -> ForeignRig:
    return read_rig(parse_description(f"{head}[cameras]\n{cameras}\n{more}", folder, "set", "set.toml"), SIZES)


def written(path: Path, **values: Any) -> str:
    """A file of OpenCV's, and what names it in a description; ``None``: it lacks that."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        if value is not None:
            storage.write(name, value)
    storage.release()
    return files(path.name)


def opencv(folder: Path, **changes: Any) -> str:
    return written(folder / "s.yml", **{**OPENCV, **changes})


def files(*names: str) -> str:
    return f"files = {json.dumps(names)}"


def text(folder: Path, name: str, content: str) -> str:
    (folder / name).write_text(content)
    return files(name)


def projected(found: ForeignRig, point_mm: tuple[float, float, float]) -> np.ndarray[Any, Any]:
    return np.concatenate([eye.project(np.array(point_mm), found.index) for eye in (found.rig.left, found.rig.right)])


def expected(point_mm: tuple[float, float, float]) -> np.ndarray[Any, Any]:
    """As OpenCV itself projects."""
    point = np.array([point_mm])
    left = cv2.projectPoints(point, np.zeros(3), np.zeros(3), M1, D1)[0].ravel()
    right = cv2.projectPoints(point, cv2.Rodrigues(R)[0], T, M2, D2)[0].ravel()
    return np.concatenate([left, right])


def flat(values: Any) -> str:
    return ", ".join(f"{one:.12g}" for one in np.ravel(values))


# ------------------------------------------------------------------------------ what each program writes into a folder
def in_words(_: Path) -> str:
    eyes = [f"[cameras.{side}]\nmatrix = {K.tolist()}\ndistortion = {D.ravel().tolist()}" for side, K, D in BOTH]
    return "\n".join([f"rotation = {R.tolist()}\ntranslation = {T.ravel().tolist()}", *eyes])


def named(folder: Path, names: str, suffix: str) -> str:
    """The six by these names."""
    values = dict(zip(names.split(), OPENCV.values(), strict=True))
    path = folder / f"c{suffix}"
    if suffix == ".npz":
        np.savez(path, **values)  # type: ignore[arg-type]
    elif suffix == ".mat":
        savemat(path, {**values, "nx": 640, "title": "rig"}, do_compression=True)
    else:
        return written(path, **values)
    return files(path.name)


def nested_json(folder: Path) -> str:
    left, right = ({"camera_matrix": K.tolist(), "dist_coeffs": D.ravel().tolist()} for _, K, D in BOTH)
    content = {"left": left, "right": right, "R": R.tolist(), "T": T.ravel().tolist(), "image_size": [640, 480]}
    return text(folder, "c.json", json.dumps(content))


def poses(folder: Path) -> str:
    """Each device's own pose of the world, one level down in a file of a folder of its own."""
    for n, (K, D, turn, way) in enumerate(((M1, D1, WORLD_R, WORLD_T), (M2, D2, R @ WORLD_R, R @ WORLD_T + T))):
        (folder / f"cam_{n}").mkdir()
        named = {"Matrix": K, "Distortion": D, "Rotation": turn, "Translation": way}
        said = "".join(
            f"<{name}>{' '.join(map(repr, value.ravel().tolist()))}</{name}>" for name, value in named.items()
        )
        text(folder, f"cam_{n}/c.xml", f"<opencv_storage><Camera>{said}</Camera></opencv_storage>")
    return files("cam_0/c.xml", "cam_1/c.xml")


def in_folders(folder: Path) -> str:
    """Matrices of one name in a folder for each, the pose beside."""
    for name, K, D in (("camera1", M1, D1), ("projector", M2, D2)):
        (folder / name).mkdir()
        np.savetxt(folder / name / "cam_matrix.txt", K)
        np.savetxt(folder / name / "dist.txt", D)
    written(folder / "extrinsic.xml", rvec=cv2.Rodrigues(R)[0], tvec=T)
    return 'files = ["camera1/cam_matrix.txt", "camera1/dist.txt", "projector/cam_matrix.txt", "projector/dist.txt", "extrinsic.xml"]'


def of_no_sides(folder: Path) -> str:
    """The same in folders of which nothing says whose they are."""
    in_folders(folder)
    (folder / "camera1").rename(folder / "a")
    (folder / "projector").rename(folder / "b")
    return (
        'files = ["b/cam_matrix.txt", "a/cam_matrix.txt", "a/dist.txt", "b/dist.txt", "extrinsic.xml"]\n[cameras.names]\n'
        'left_matrix = "a/cam_matrix.txt"\nright_matrix = "b/cam_matrix.txt:cam_matrix"\nleft_distortion = "a/dist.txt"\n'
        'right_distortion = "b/dist.txt"'
    )


def of_the_world(folder: Path) -> str:
    """Each with the pose of the world in it, called as those between two cameras are."""
    written(folder / "left.yml", camera_matrix=M1, dist_coeffs=D1, R=WORLD_R, T=WORLD_T)
    written(folder / "right.yml", camera_matrix=M2, dist_coeffs=D2, R=R @ WORLD_R, T=R @ WORLD_T + T)
    return files("right.yml", "left.yml")


def of_the_right_alone(folder: Path) -> str:
    written(folder / "left.yml", camera_matrix=M1, dist_coeffs=D1)
    written(folder / "right.yml", camera_matrix=M2, dist_coeffs=D2, R=R, T=T)
    return files("right.yml", "left.yml")


def rectified_too(folder: Path) -> str:
    """All that OpenCV's sample writes: what brings both to one plane says the pose once more."""
    R1, R2, P1, P2 = cv2.stereoRectify(M1, D1, M2, D2, (640, 480), R, T)[:4]
    written(
        folder / "c.yml", M1=M1, D1=D1, M2=M2, D2=D2, R=R, T=T, R1=R1, R2=R2, P1=P1, P2=P2, S=np.array([640.0, 480.0])
    )
    return files("c.yml")


def two_ways_of_which_one_is_named(folder: Path) -> str:
    """And a distortion that is said twice, with zeros behind."""
    more = {"dist1": np.append(D1, [0.0, 0.0, 0.0]), "R1": WORLD_R, "T1": WORLD_T, "R2": WORLD_R.T, "T2": T}
    written(folder / "c.yml", M1=M1, D1=D1, M2=M2, D2=D2, R=R, T=T, **more)
    return 'files = "c.yml"\n[cameras.names]\nrotation = "R"\ntranslation = "T"'


def named_turn(folder: Path) -> str:
    """A rotation that is named holds, and not that which rectifies both; the translation is that."""
    R1, R2, P1, P2 = cv2.stereoRectify(M1, D1, M2, D2, (640, 480), np.eye(3), T)[:4]
    written(folder / "c.yml", M1=M1, D1=D1, M2=M2, D2=D2, R1=R1, R2=R2, P1=P1, P2=P2, turn=R)
    return 'files = "c.yml"\n[cameras.names]\nrotation = "turn"'


def a_list_of_tables(folder: Path) -> str:
    both = [{"K": K.tolist(), "D": D.ravel().tolist()} for _, K, D in BOTH]
    content = {"rig": {"cameras": both}, "R": R.tolist(), "T": T.ravel().tolist()}
    return text(folder, "c.json", json.dumps(content))


def lines_below_names(folder: Path) -> str:
    named = {"left K": M1, "left D": D1, "right K": M2, "right D": D2, "R": R, "T": T}
    with np.printoptions(precision=17):
        return text(folder, "c.txt", "".join(f"{name}:\n{value}\n" for name, value in named.items()))


def slmaster(folder: Path) -> str:
    """Two cameras and a projector; ``S`` is the cameras' size."""
    cameras = {"M1": M1, "D1": D1, "M2": M1, "D2": D1, "Rlr": np.eye(3), "Tlr": -T, "S": np.array([640.0, 480.0])}
    written(folder / "c.yml", **cameras, M4=M2, D4=D2, Rlp=R, Tlp=T)
    return files("c.yml")


def kalibr(folder: Path, model: str = "radtan") -> str:
    """Lists as its YAML has them: each row's dash at the level of the key."""
    said = []
    for n, (_, K, D) in enumerate(BOTH):
        said.append(
            f"cam{n}:\n  cam_overlaps: [{1 - n}]\n  camera_model: pinhole\n  distortion_coeffs: [{flat(D[0, :4])}]\n  distortion_model: {model}\n"
            f"  intrinsics: [{flat((K[0, 0], K[1, 1], K[0, 2], K[1, 2]))}]\n  resolution: [640, 480]\n  rostopic: /cam{n}/image_raw\n"
        )
    pose = np.vstack([np.column_stack([R, 0.001 * T]), [0.0, 0.0, 0.0, 1.0]])
    said += ["  T_cn_cnm1:\n", *(f"  - [{flat(row)}]\n" for row in pose)]
    return text(folder, "camchain.yaml", "".join(said)) + '\nunit = "m"'


def ros(folder: Path) -> str:
    """``camera_info`` of both: the pose is in what rectifies them."""
    R1, R2, P1, P2 = cv2.stereoRectify(M1, D1, M2, D2, (640, 480), R, 0.001 * T)[:4]
    for (side, K, D), turn, P in zip(BOTH, (R1, R2), (P1, P2), strict=True):
        parts = {"camera_matrix": K, "distortion_coefficients": D, "rectification_matrix": turn, "projection_matrix": P}
        said = [f"image_width: 640\nimage_height: 480\ncamera_name: {side}\ndistortion_model: plumb_bob\n"]
        for name, m in parts.items():
            said.append(f"{name}:\n  rows: {m.shape[0]}\n  cols: {m.shape[1]}\n  data: [{flat(m)}]\n")
        text(folder, f"{side}.yaml", "".join(said))
    return files("right.yaml", "left.yaml") + '\nunit = "m"'


def matlab_struct() -> dict[str, Any]:
    """``toStruct(stereoParams)``: pixels from 1, rows times matrices."""
    cameras = {}
    for n, (_, K, D) in enumerate(BOTH, 1):
        cameras[f"CameraParameters{n}"] = {
            "RadialDistortion": D[0, :2], "TangentialDistortion": D[0, 2:4], "ImageSize": np.array([480.0, 640.0]), "EstimateSkew": False,
            "IntrinsicMatrix": (K + np.array([[0, 0, 1.0], [0, 0, 1.0], [0, 0, 0]])).T, "WorldUnits": "mm",
        }  # fmt: skip
    return {**cameras, "RotationOfCamera2": R.T, "TranslationOfCamera2": T.ravel(), "Version": {"Major": 1.0}}


def matlab(folder: Path) -> str:
    savemat(folder / "stereo.mat", {"s": matlab_struct()}, do_compression=True)
    return files("stereo.mat")


def matlab_json(folder: Path) -> str:
    return text(folder, "stereo.json", json.dumps(matlab_struct(), default=lambda one: one.tolist()))


def bouguet(folder: Path) -> str:
    values: dict[str, Any] = {"om": cv2.Rodrigues(R)[0], "R": R, "T": T, "nx": 640.0, "recompute_intrinsic_left": 1.0}
    for side, K, D in BOTH:
        values |= {f"fc_{side}": K[[0, 1], [0, 1]][:, None], f"cc_{side}": K[:2, 2:], f"kc_{side}": D.T, f"alpha_c_{side}": 0.0}  # fmt: skip
    savemat(folder / "Calib_Results_stereo.mat", values)
    return files("Calib_Results_stereo.mat")


def renderings(folder: Path) -> str:
    """By Blender: of each device its place in the world, and the turn of the world into it."""
    for name, K, D, turn, t in (("camera", M1, D1, np.eye(3), np.zeros((3, 1))), ("projector", M2, D2, R, T)):
        rotate, translate = cv2.Rodrigues(turn)[0].ravel(), (-turn.T @ t).ravel()
        said = {"image_size": [640, 480], "intrinsic": K, "distortion": D, "rotate": rotate, "translate": translate}
        (folder / f"{name}.json").write_text(json.dumps(said, default=lambda one: one.tolist()))
    return files("camera.json", "projector.json")


def a_file_for_each(folder: Path) -> str:
    """As ``np.save`` and ``np.savetxt`` leave them."""
    np.save(folder / "mtx_left.npy", M1)
    np.save(folder / "dist_left.npy", D1)
    np.savetxt(folder / "K_right.txt", M2)
    np.savetxt(folder / "D_right.csv", D2, delimiter=",")
    np.savetxt(folder / "R.txt", R)
    np.savetxt(folder / "T.txt", T)
    return files("mtx_left.npy", "dist_left.npy", "K_right.txt", "D_right.csv", "R.txt", "T.txt")


OF_PROGRAMS: dict[str, Callable[[Path], str]] = {
    "opencv": partial(named, names="M1 D1 M2 D2 R T", suffix=".yml"),
    "opencv xml": partial(named, names="cameraMatrix1 distCoeffs1 cameraMatrix2 distCoeffs2 R T", suffix=".xml"),
    "tutorial": partial(named, names="cam1_intrinsics cam1_distorsion cam2_intrinsics cam2_distorsion R T", suffix=".json"),
    "numpy": partial(named, names="mtxL distL mtxR distR R T", suffix=".npz"),
    "from nought": partial(named, names="K0 D0 K1 D1 R T", suffix=".npz"),
    "toolbox": partial(named, names="KK_left kc_left KK_right kc_right om T", suffix=".mat"),
    **{write.__name__: write for write in (
        in_words, nested_json, of_no_sides, of_the_world, of_the_right_alone, rectified_too, poses, named_turn, two_ways_of_which_one_is_named,
        a_list_of_tables, lines_below_names, kalibr, ros, matlab, matlab_json, bouguet, a_file_for_each,
    )},
}  # fmt: skip
OF_PROJECTORS: dict[str, Callable[[Path], str]] = {
    "camera and projector": partial(named, names="cam_K cam_kc proj_K proj_kc R T", suffix=".xml"),
    "slstudio": partial(named, names="Kc kc Kp kp Rp Tp", suffix=".xml"),
    **{write.__name__: write for write in (in_folders, slmaster, renderings)},
}  # fmt: skip


@pytest.mark.parametrize("name", [*OF_PROGRAMS, *OF_PROJECTORS])
def test_another_programs_file_projects_as_its_cameras_do(tmp_path: Path, name: str) -> None:
    write = {**OF_PROGRAMS, **OF_PROJECTORS}[name]
    found = rig(tmp_path, write(tmp_path), head=ALONE if name in OF_PROJECTORS else HEAD)
    assert found.in_air
    for point in ((0.0, 0.0, 500.0), (60.0, -40.0, 700.0), (-80.0, 50.0, 400.0)):
        np.testing.assert_allclose(projected(found, point), expected(point), atol=1e-5)


def test_water_bends_rays_behind_ports_only(tmp_path: Path) -> None:
    opencv(tmp_path)
    ports = "[ports]\ndistance_mm = 20\nthickness_mm = 5\nglass_index = 1.5\n"
    wet = rig(tmp_path, 'files = "s.yml"', f"{ports}[water]\nindex = 1.333")
    pinhole = rig(tmp_path, 'files = "s.yml"', "[water]\ntemperature_c = 20")
    point = (100.0, 0.0, 600.0)
    assert pinhole.index == pytest.approx(1.335, abs=0.002)
    np.testing.assert_allclose(projected(pinhole, point), expected(point), atol=1e-6)
    # Water magnifies: the point is seen farther from the centre, by 4/3 far away and less near the port.
    assert 1.2 < (projected(wet, point)[0] - 320.0) / (expected(point)[0] - 320.0) < 1.34
    # Windows of which nothing is said are square to the axes: along these, light goes straight on.
    x, y, z = (R.T @ (np.array([0.0, 0.0, 600.0]) - T.ravel())).tolist()
    np.testing.assert_allclose(projected(wet, (0.0, 0.0, 600.0))[:2], M1[:2, 2], atol=1e-6)
    np.testing.assert_allclose(projected(wet, (x, y, z))[2:], M2[:2, 2], atol=1e-6)


@pytest.mark.parametrize("values", [[9.3, 5.2, 0.001, -0.001, 0.31, 9.7, 7.9, 1.2], [-0.1, 0.02, 0.05, -0.04, 0.003, 0.0, 0.0, 0.0, 0.03, 0.02, -0.03, 0.04, 0, 0]])  # fmt: skip
def test_longer_lens_models_are_opencvs(values: list[float]) -> None:
    lens = lens_of(M1, np.array(values), (640, 480), "left")
    points = np.array([[0.3, -0.2, 1.0], [-0.35, 0.25, 1.0], [0.0, 0.0, 1.0], [0.01, 0.3, 1.0]])
    wanted = np.asarray(
        cv2.projectPoints(points, np.zeros(3), np.zeros(3), M1, np.array(values))[0], np.float64
    ).reshape(-1, 2)
    np.testing.assert_allclose(lens.to_pixels(points[:, :2]), wanted, atol=1e-9)
    np.testing.assert_allclose(lens.to_normalised(wanted), points[:, :2], atol=1e-9)
    with pytest.raises(ForeignError, match=r"has 14 values, .* the last two zero \(no tilted sensor\); correct it"):
        lens_of(M1, np.array([*values[:8], 0.0, 0.0, 0.0, 0.0, 0.0, 0.01]), (640, 480), "left")


@pytest.mark.parametrize("text", ["cam_matrix", "none", "b/cam_matrix.txt:R"])
def test_a_name_that_two_files_have_is_told_apart(text: str, tmp_path: Path) -> None:
    said = of_no_sides(tmp_path).replace('left_matrix = "a/cam_matrix.txt"', f'left_matrix = "{text}"')
    allowed = (
        '"b/cam_matrix.txt:cam_matrix" or "a/cam_matrix.txt:cam_matrix"; say which'
        if text == "cam_matrix"
        else "a name of 9 numbers in one of"
    )
    with pytest.raises(ForeignError) as error:
        rig(tmp_path, said)
    assert f"cameras.names.left_matrix is '{text}'; allowed: {allowed}" in str(error.value)


def test_our_own_calibration_is_found_first(tmp_path: Path) -> None:
    assert cameras_in(tmp_path) == {}
    found = rig(tmp_path, in_folders(tmp_path), head=ALONE)
    mine = Calibration("pair", IN_AIR, "unknown", ("pictures",), Water(20.0, 0.0, 530.0), found.rig)
    (tmp_path / "pair.json").write_bytes(encode_calibration(mine))
    assert cameras_in(tmp_path) == {"calibration": "pair.json"}


def test_matrices_of_projection_are_taken_apart(tmp_path: Path) -> None:
    first, second = M1 @ np.hstack([WORLD_R, WORLD_T]), -2.5 * M2 @ np.hstack([R @ WORLD_R, R @ WORLD_T + T])
    np.savez(tmp_path / "c.npz", P1=first, P2=second)
    found = rig(tmp_path, 'files = "c.npz"')
    point = np.array([30.0, -20.0, 650.0])
    world = WORLD_R.T @ (point - WORLD_T.ravel())
    for camera, matrix in ((found.rig.left, first), (found.rig.right, second)):
        seen = matrix @ np.append(world, 1.0)
        np.testing.assert_allclose(camera.project(point, 1.0), seen[:2] / seen[2], atol=1e-6)


def test_rectified_images_of_middlebury_are_side_by_side(tmp_path: Path) -> None:
    said = "cam0=[900.5 0 311.2; 0 900.5 254.8; 0 0 1]\ncam1=[900.5 0 342.3; 0 900.5 254.8; 0 0 1]\ndoffs=31.1\nbaseline=193.0\n"
    found = rig(
        tmp_path, text(tmp_path, "calib.txt", f"{said}width=640\nheight=480\nndisp=290\nisint=0\nvmin=23\nvmax=225\n")
    )
    left_u, left_v, right_u, right_v = projected(found, (30.0, -20.0, 2000.0))
    # z = baseline · f / (disparity + doffs), as Middlebury's page says.
    assert 193.0 * 900.5 / (left_u - right_u + 31.1) == pytest.approx(2000.0, abs=1e-6)
    assert left_v == pytest.approx(right_v, abs=1e-9)


def of_length(folder: Path, length: float) -> str:
    return opencv(folder, T=length * T / np.linalg.norm(T))


@pytest.mark.parametrize(
    ("length", "unit", "known", "length_mm"),
    [(10.0, "cm", True, 100.0), (3.937, "inch", True, 100.0), (1.0004, None, False, 1.0), (1.0004, "m", True, 1000.0)],
)
def test_lengths_become_millimetres_and_a_translation_of_length_one_has_no_scale(
    tmp_path: Path, length: float, unit: str | None, known: bool, length_mm: float
) -> None:
    found = rig(tmp_path, of_length(tmp_path, length) + (f'\nunit = "{unit}"' if unit else ""))
    assert np.linalg.norm(found.rig.right.translation_mm) == pytest.approx(length_mm, rel=1e-3)
    assert (found.scale_known, len(found.notes)) == (known, int(length < 2.0))


def test_a_principal_point_far_from_the_middle_is_a_shifted_lens_and_worth_a_line(tmp_path: Path) -> None:
    for down, noted in ((206.0, True), (450.0, False)):
        found = rig(tmp_path, opencv(tmp_path, M2=M2 + np.array([[0, 0, 0], [0, 0, down], [0, 0, 0]])))
        wanted = expected((10.0, 20.0, 600.0)) + np.array([0.0, 0.0, 0.0, down])
        np.testing.assert_allclose(projected(found, (10.0, 20.0, 600.0)), wanted, atol=1e-6)
        assert any("95 %" in note for note in found.notes) == noted


# ------------------------------------------------------------------------------------------------- what is wrong
BESIDE = np.array([[0, 0, 5000.0], [0, 0, 0], [0, 0, 0]])
WRONG_FILES: list[tuple[dict[str, Any], str]] = [
    ({"R": 2.0 * R}, "no rotation"),
    ({"T": 0.0 * T}, "zero"),
    ({"M1": None}, "left_matrix .* D1, M2"),
    ({"M2": M2 + BESIDE}, "far outside images"),
    ({"D1": np.zeros((1, 3))}, "left distortion has 3 values"),
    ({"D1": np.zeros((1, 7))}, "left distortion has 7 values"),
    # What is said twice, and differs.
    ({"K1": M1 * np.array([[1.1], [1], [1]])}, "s.yml: M1 and s.yml: K1"),
    ({"rvec": np.array([0.01, -0.2, 0.05])}, "s.yml: R and s.yml: rvec"),
    (
        {"R1": WORLD_R, "T1": WORLD_T, "R2": R.T @ WORLD_R, "T2": R @ WORLD_T + T},
        "s.yml: R1 with s.yml: R2 .* 23",
    ),
    ({"S": np.array([320.0, 240.0])}, "S says 320 x 240 px, .* half the size"),
    ({"image_width": 640, "image_height": 512}, "640 x 512 px"),
    ({"proj_K": M2, "M2": None}, "proj_K is that of a projector"),
    ({"T": 1640.0 * T}, r"baseline is 1\.65e\+05 mm"),
    ({"T": 0.001 * T}, r'baseline is 0\.101 mm.* cameras\.unit = "m"'),
]


@pytest.mark.parametrize(("values", "said"), WRONG_FILES)
def test_cameras_that_cannot_be_or_are_said_twice_are_refused(
    tmp_path: Path, values: dict[str, Any], said: str
) -> None:
    with pytest.raises(ForeignError, match=said):
        rig(tmp_path, opencv(tmp_path, **values))


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("rotation = [[", "rotation = [[1], [", r"cameras\.rotation"),
        ("translation = [", "translation = [1, ", r"cameras\.translation"),
        ("[cameras.right]\nmatrix = [[", "[cameras.right]\nmatrix = [[inf, ", r"cameras\.right\.matrix"),
        ("[cameras.right]\nmatrix = [[", "[cameras.right]\nmatrx = [[", r"cameras\.right\.matrx"),
        ("matrix = [[800.0", "matrix = [[nan", r"left\.matrix is \[nan"),
        ("distortion = [-0.1", 'distortion = ["x"', r"cameras\.left\.distortion is \['x'"),
        ("[cameras.left]", "[cameras.near]", r"cameras\.near"),
    ],
)
def test_numbers_in_the_description_that_cannot_be_are_named(
    tmp_path: Path, before: str, after: str, said: str
) -> None:
    words = in_words(tmp_path)
    assert before in words
    with pytest.raises(ForeignError, match=said):
        rig(tmp_path, words.replace(before, after, 1))


def matlabs_own(folder: Path) -> str:
    """``save stereo.mat stereoParams``: an array of class 17, which nobody but MATLAB reads."""
    flags = struct.pack("<IIII", 6, 8, 17, 0)
    names = b"".join(
        struct.pack("<II", 1, len(name)) + name + b"\0" * (-len(name) % 8)
        for name in (b"stereoParams", b"MCOS", b"stereoParameters")
    )
    content = struct.pack("<8I", 6, 8, 13, 0, 5, 8, 1, 1) + struct.pack("<6I", 1, 0, 6, 4, 7, 0)
    body = flags + names + struct.pack("<II", 14, len(content)) + content
    header = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    (folder / "stereo.mat").write_bytes(header + struct.pack("<II", 14, len(body)) + body)
    return files("stereo.mat")


@pytest.mark.parametrize(
    ("write", "said"),
    [
        (lambda folder: files("none.yml"), "none.yml"),
        (lambda folder: kalibr(folder, "equidistant"), "cam0.distortion_model is 'equidistant'; allowed: radtan"),
        (lambda folder: text(folder, "cameras.txt", "# Camera list\n1 OPENCV 640 480 800 810 320 240 0 0 0 0\n"), "NAME = NUMBERS"),
        (lambda folder: text(folder, "s.yaml", "a:\n- [1, 2\nb: 3\n"), "while parsing a flow sequence"),
        (matlabs_own, r"toStruct\(stereoParams\)"),
    ],
)  # fmt: skip
def test_a_file_that_cannot_be_read_says_what_to_write(tmp_path: Path, write: Callable[[Path], str], said: str) -> None:
    with pytest.raises(ForeignError, match=said):
        rig(tmp_path, write(tmp_path))


@pytest.mark.parametrize(
    ("name", "content", "wanted"),
    [
        ("s.json", '{"a": [1, 2], "a": [1, 2], "__b": 3, "c": "4"}', {"a": [1, 2]}),
        ("s.json", '{"a": [1, 2], "a": [1, 3]}', "a has two different values"),
        ("s.json", '[{"K": 1}, {"D": [{"a": 2}, {"a": 3}]}, 4]', {"K": 1, "D.0.a": 2, "D.1.a": 3}),
        ("s.json", '{"m": {"rows": 1, "cols": 1, "data": [2]}, "n": {"rows": 1, "data": 3}, "o": {"sizes": 1, "data": 4}}', {"m": [2], "n.rows": 1, "n.data": 3, "o": 4}),
        ("s.json", "[1, 2]", "it holds no names"),
        ("s.yaml", "\ufeff%YAML:1.0\na:\t-.INF\nb: '1'\nc: !!tag [1, 2.5]\n---\nd: 7\n", {"a": -np.inf, "c": [1, 2.5], "d": 7}),
        ("s.yaml", "a: &x 1\nb: *x\n", "line 2: an alias"),
        ("s.yaml", f"a: {'[' * 12}1{']' * 12}", {"a": [[[[[[[[[[[[1]]]]]]]]]]]]}),
        ("s.yaml", f"b: 1\na: {'[' * 13}1{']' * 13}", "line 2: more than 12 levels"),
        ("s.xml", "<o><a>1 2</a><b>x 3</b><c>3</c><l><_>1</_><_>2</_></l><m><x>5</x></m></o>", {"a": [1, 2], "c": 3, "l": [1, 2], "m.x": 5}),
        ("s.xml", f"<o><p>1</p>{'<a>' * 12}1{'</a>' * 12}</o>", {"p": 1, ".".join("a" * 12): 1}),
        ("s.xml", f"{'<a>' * 14}1{'</a>' * 14}", "more than 12 levels"),
        ("s.xml", " <!DOCTYPE a><a><b>1</b></a>", "it has a document type definition"),
        ("s.txt", "1 2 # 9\n# 8\n3;4\nK = [5, 6; 7 8]\n(9)\nfree: text\n10\n", {"s": [1, 2, 3, 4], "K": [5, 6, 7, 8, 9], "free": [10]}),
    ],
)  # fmt: skip
def test_numbers_of_a_text_have_names_or_it_says_why_not(
    tmp_path: Path, name: str, content: str, wanted: dict[str, Any] | str
) -> None:
    text(tmp_path, name, content)
    if isinstance(wanted, str):
        with pytest.raises(ForeignError, match=f"not readable as .* [(]{wanted}[)]; correct it"):
            numbers_in(tmp_path / name)
    else:
        assert {name: array.tolist() for name, array in numbers_in(tmp_path / name).items()} == wanted


SLSTUDIO = {"Kc": M1, "kc": D1, "Kp": M2, "kp": D2, "Rp": R, "Tp": T, "frameWidth": 640, "frameHeight": 480}


@pytest.mark.parametrize(
    ("values", "beside", "where"),
    [
        ({**SLSTUDIO, "screenResX": 1824, "screenResY": 1140}, {}, "s.xml: screenResX, screenResY"),
        ({**OPENCV, "screenResY": 1140, "screenResX": 1824}, {}, "s.xml: screenResX, screenResY"),
        (OPENCV, {"image_size": np.array([1824.0, 1140.0])}, "projector.xml: image_size"),
    ],
)
def test_a_projector_of_another_size_than_its_calibration_says_is_refused(
    tmp_path: Path, values: dict[str, Any], beside: dict[str, Any], where: str
) -> None:
    """Also where the height stands first, or a file says nothing else; in a folder that file is found."""
    written(tmp_path / "s.xml", **values)
    if beside:
        written(tmp_path / "projector.xml", **beside)
    files = cameras_in(tmp_path)["files"]
    with pytest.raises(
        ForeignError,
        match=rf"{where} says 1824 x 1140 px, and \[projector\] says 640 x 480 px: another projector; correct its size",
    ):
        rig(tmp_path, f"files = {files}", head=ALONE)
    if "Kc" not in values:
        assert rig(tmp_path, f"files = {files}").notes == (
            f"cameras.files: {where} says 1824 x 1140 px, and [projector] 640 x 480 px",
        ), "of two cameras it is worth a line"
    right = ALONE.replace("640", "1824").replace("480", "1140")
    said = parse_description(f"{right}[cameras]\nfiles = {files}\n", tmp_path, "set", "set.toml")
    assert read_rig(said, SIZES | {"right": (1824, 1140)}).stated_px["right"] == (1824, 1140)


@pytest.mark.parametrize(
    ("write", "unit"),
    [(in_folders, "mm"), (of_the_world, "mm"), (slmaster, "mm"), (partial(of_length, length=0.1), "m"),
     (partial(of_length, length=2.9), "m"), (partial(of_length, length=3.1), "mm")],
)  # fmt: skip
def test_camera_files_are_found_in_a_folder(write: Callable[[Path], str], unit: str, tmp_path: Path) -> None:
    wanted = tomllib.loads(write(tmp_path))["files"]
    (tmp_path / "notes.txt").write_text("exposure = 12\n1 2 3\n")
    np.savez(tmp_path / "points.npz", xyz=np.zeros((40, 3)), size=np.array([4.0, 4.0]))
    found = cameras_in(tmp_path)
    assert sorted(found["files"]) == sorted([wanted] if isinstance(wanted, str) else wanted)
    assert found["unit"] == unit
