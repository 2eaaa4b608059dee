"""Cameras of others: the same rig from OpenCV's files, matrices in the description and our own file; and what is wrong is named."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.io import savemat

from appliance.calibration.file import IN_AIR, Calibration, encode
from appliance.foreign.camera_files import cameras_in
from appliance.foreign.cameras import ForeignRig, lens_of, read_rig
from appliance.foreign.description import parse_description
from appliance.foreign.problem import ForeignError
from appliance.optics.water import Water

SIZES = {"left": (640, 480), "right": (640, 480)}
M1 = np.array([[800.0, 0, 320], [0, 810, 240], [0, 0, 1]])
M2 = np.array([[790.0, 0, 310], [0, 795, 250], [0, 0, 1]])
D1, D2 = np.array([[-0.1, 0.05, 0.001, -0.002, 0.01]]), np.array([[-0.08, 0.02, 0.0, 0.0]])
R = cv2.Rodrigues(np.array([0.01, -0.2, 0.03]))[0]
T = np.array([[-100.0], [2.0], [10.0]])
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


def written(path: Path, **values: Any) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in values.items():
        storage.write(name, value)
    storage.release()


def projected(found: ForeignRig, point_mm: tuple[float, float, float]) -> np.ndarray[Any, Any]:
    return np.concatenate(
        [camera.project(np.array(point_mm), found.index) for camera in (found.rig.left, found.rig.right)]
    )


def expected(point_mm: tuple[float, float, float], scale: float = 1.0) -> np.ndarray[Any, Any]:
    """As OpenCV itself projects."""
    point = np.array([point_mm])
    left = cv2.projectPoints(point, np.zeros(3), np.zeros(3), M1, D1)[0].ravel()
    right = cv2.projectPoints(point, cv2.Rodrigues(R)[0], scale * T, M2, D2)[0].ravel()
    return np.concatenate([left, right])


@pytest.mark.parametrize("name", ["stereo.yml", "stereo.xml", "stereo.json"])
def test_opencvs_files_project_as_opencv_does(tmp_path: Path, name: str) -> None:
    written(tmp_path / name, M1=M1, D1=D1, M2=M2, D2=D2, R=R, T=T)
    found = rig(tmp_path, f'files = "{name}"')
    assert found.in_air
    for point in ((0.0, 0.0, 500.0), (60.0, -40.0, 700.0), (-80.0, 50.0, 400.0)):
        np.testing.assert_allclose(projected(found, point), expected(point), atol=1e-6)


def test_other_names_units_and_several_files(tmp_path: Path) -> None:
    written(tmp_path / "intrinsics.yml", cameraMatrix1=M1, distCoeffs1=D1, cameraMatrix2=M2, distCoeffs2=D2)
    written(tmp_path / "extrinsics.yml", R=R, T=0.001 * T, R1=np.eye(3), Q=np.eye(4))
    found = rig(tmp_path, 'files = ["intrinsics.yml", "extrinsics.yml"]\nunit = "m"')
    np.testing.assert_allclose(projected(found, (10.0, 20.0, 600.0)), expected((10.0, 20.0, 600.0)), atol=1e-6)
    written(tmp_path / "left.yml", camera_matrix=M1, distortion_coefficients=D1)
    written(tmp_path / "right.yml", camera_matrix=M2, distortion_coefficients=D2)
    single = rig(tmp_path, 'files = ["right.yml", "left.yml", "extrinsics.yml"]\nunit = "m"')
    assert single.rig == found.rig
    np.savez(tmp_path / "all.npz", mtxL=M1, distL=D1, mtxR=M2, distR=D2, R=R, T=T)
    assert rig(tmp_path, 'files = "all.npz"').rig.left == found.rig.left
    written(tmp_path / "odd.yml", eye_a=M1, eye_b=M2, twist=cv2.Rodrigues(R)[0], shift=T)
    names = '[cameras.names]\nleft_matrix = "eye_a"\nright_matrix = "eye_b"\nrotation = "twist"\ntranslation = "shift"'
    odd = rig(tmp_path, 'files = "odd.yml"', names)
    np.testing.assert_allclose(odd.rig.right.rotation, found.rig.right.rotation, atol=1e-9)


IN_WORDS = (
    f"rotation = {R.tolist()}\ntranslation = {T.ravel().tolist()}\n[cameras.left]\nmatrix = {M1.tolist()}\n"
    f"distortion = {D1.ravel().tolist()}\n[cameras.right]\nmatrix = {M2.tolist()}\ndistortion = {D2.ravel().tolist()}"
)


def test_matrices_in_the_description(tmp_path: Path) -> None:
    found = rig(tmp_path, IN_WORDS)
    np.testing.assert_allclose(projected(found, (10.0, 20.0, 600.0)), expected((10.0, 20.0, 600.0)), atol=1e-6)


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        ("rotation = [[", "rotation = [[1], [", r"cameras.rotation is \[\[1\], .*; allowed: 9 or 3 numbers; correct it"),
        ("translation = [", "translation = [1, ", r"cameras.translation is \[1, .*; allowed: 3 numbers; correct it"),
        ("[cameras.right]\nmatrix = [[", "[cameras.right]\nmatrix = [[inf, ", r"cameras.right.matrix is .*; allowed: 9 numbers; correct it"),
        ("[cameras.right]\nmatrix = [[", "[cameras.right]\nmatrx = [[", "cameras.right.matrx: unknown key; did you mean matrix?"),
        ("matrix = [[800.0", "matrix = [[nan", r"left.matrix is \[nan, .*; allowed are finite numbers below 1e\+09; correct it"),
        ("distortion = [-0.1", 'distortion = ["x"', r"cameras.left.distortion is \['x', .*; allowed: 2 or 3 or .* numbers; correct it"),
        ("[cameras.left]", "[cameras.near]", r"cameras.near: unknown key"),
    ],
)  # fmt: skip
def test_numbers_in_the_description_that_cannot_be_are_named(
    tmp_path: Path, before: str, after: str, said: str
) -> None:
    text = IN_WORDS.replace(before, after, 1)
    assert text != IN_WORDS
    with pytest.raises(ForeignError, match=said):
        rig(tmp_path, text)


def test_water_bends_rays_behind_ports_only(tmp_path: Path) -> None:
    written(tmp_path / "s.yml", M1=M1, D1=D1, M2=M2, D2=D2, R=R, T=T)
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


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"R": 2.0 * R}, "is no rotation"),
        ({"T": 0.0 * T}, "translation is zero"),
        ({"M1": None}, "have no left_matrix under a name that is known (s.yml: D1, M2"),
        (
            {"M2": M2 * np.array([[1.0], [1.0], [1.0]]) + np.array([[0, 0, 5000.0], [0, 0, 0], [0, 0, 0]])},
            "lies far outside of images",
        ),
        ({"D1": np.zeros((1, 3))}, "left distortion has 3 values, [0.0, 0.0, 0.0]; allowed are 4, 5, 8, 12, 14"),
        ({"D1": np.zeros((1, 7))}, "left distortion has 7 values, [0.0, 0.0,"),
    ],
)
def test_cameras_that_cannot_be_are_refused(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    values = {"M1": M1, "D1": D1, "M2": M2, "D2": D2, "R": R, "T": T, **change}
    written(tmp_path / "s.yml", **{name: value for name, value in values.items() if value is not None})
    with pytest.raises(ForeignError) as error:
        rig(tmp_path, 'files = "s.yml"')
    assert said in str(error.value)


def test_a_file_that_is_none_is_named(tmp_path: Path) -> None:
    with pytest.raises(ForeignError, match=r"none.yml: No such file or directory; give the file"):
        rig(tmp_path, 'files = "none.yml"')
    (tmp_path / "text.yml").write_text("camera: [1, 2")
    with pytest.raises(ForeignError, match="not readable as YAML or XML"):
        rig(tmp_path, 'files = "text.yml"')


FLAT = ", ".join(f"{one:.12g}" for one in np.ravel(M1))
WORLD_R, WORLD_T = cv2.Rodrigues(np.array([0.2, 0.1, -0.3]))[0], np.array([[20.0], [-30.0], [900.0]])


def tutorial(folder: Path) -> str:
    written(folder / "c.yml", cam1_intrinsics=M1, cam1_distorsion=D1, cam2_intrinsics=M2, cam2_distorsion=D2, R=R, T=T)
    return 'files = "c.yml"'


def camera_and_projector(folder: Path) -> str:
    written(folder / "c.xml", cam_K=M1, cam_kc=D1, proj_K=M2, proj_kc=D2, R=R, T=T, cam_error=0.2, stereo_error=0.3)
    return 'files = "c.xml"'


def matlab(folder: Path) -> str:
    values = {"KK_left": M1, "kc_left": D1.T, "KK_right": M2, "kc_right": D2, "om": cv2.Rodrigues(R)[0], "T": T}
    savemat(folder / "c.mat", {**values, "nx": 640, "title": "rig"}, do_compression=True)
    return 'files = "c.mat"'


def plain_json(folder: Path) -> str:
    left, right = ({"camera_matrix": K.tolist(), "dist_coeffs": D.ravel().tolist()} for K, D in ((M1, D1), (M2, D2)))
    content = {"left": left, "right": right, "R": R.tolist(), "T": T.ravel().tolist(), "image_size": [640, 480]}
    (folder / "c.json").write_text(json.dumps(content))
    return 'files = "c.json"'


def counted_from_nought(folder: Path) -> str:
    np.savez(folder / "c.npz", K0=M1, D0=D1, K1=M2, D1=D2, R=R, T=T)
    return 'files = "c.npz"'


def poses(folder: Path) -> str:
    for n, (K, D, turn, way) in enumerate(((M1, D1, WORLD_R, WORLD_T), (M2, D2, R @ WORLD_R, R @ WORLD_T + T))):
        (folder / f"cam_{n}").mkdir()
        storage = cv2.FileStorage(str(folder / f"cam_{n}" / "c.xml"), cv2.FILE_STORAGE_WRITE)
        storage.startWriteStruct("Camera", cv2.FileNode_MAP)
        for name, value in (("Matrix", K), ("Distortion", D), ("Rotation", turn), ("Translation", way)):
            storage.write(name, value)
        storage.endWriteStruct()
        storage.release()
    return 'files = ["cam_0/c.xml", "cam_1/c.xml"]'


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
    return 'files = ["right.yml", "left.yml"]'


def of_the_right_alone(folder: Path) -> str:
    written(folder / "left.yml", camera_matrix=M1, dist_coeffs=D1)
    written(folder / "right.yml", camera_matrix=M2, dist_coeffs=D2, R=R, T=T)
    return 'files = ["right.yml", "left.yml"]'


def rectified_too(folder: Path) -> str:
    """All that OpenCV's sample writes: what brings both to one plane says the pose once more."""
    R1, R2, P1, P2 = cv2.stereoRectify(M1, D1, M2, D2, (640, 480), R, T)[:4]
    written(
        folder / "c.yml", M1=M1, D1=D1, M2=M2, D2=D2, R=R, T=T, R1=R1, R2=R2, P1=P1, P2=P2, S=np.array([640.0, 480.0])
    )
    return 'files = "c.yml"'


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
    both = [{"K": K.tolist(), "D": D.ravel().tolist()} for K, D in ((M1, D1), (M2, D2))]
    (folder / "c.json").write_text(json.dumps({"rig": {"cameras": both}, "R": R.tolist(), "T": T.ravel().tolist()}))
    return 'files = "c.json"'


def lines_below_names(folder: Path) -> str:
    with np.printoptions(precision=17):
        said = [
            f"{name}:\n{value}\n"
            for name, value in (("left K", M1), ("left D", D1), ("right K", M2), ("right D", D2), ("R", R), ("T", T))
        ]
    (folder / "c.txt").write_text("".join(said))
    return 'files = "c.txt"'


def slmaster(folder: Path) -> str:
    """Two cameras and a projector; ``S`` is the cameras' size."""
    cameras = {"M1": M1, "D1": D1, "M2": M1, "D2": D1, "Rlr": np.eye(3), "Tlr": -T, "S": np.array([640.0, 480.0])}
    written(folder / "c.yml", **cameras, M4=M2, D4=D2, Rlp=R, Tlp=T)
    return 'files = "c.yml"'


@pytest.mark.parametrize(
    ("write", "head"),
    [
        (in_folders, ALONE), (of_no_sides, HEAD), (of_the_world, HEAD), (of_the_right_alone, HEAD), (rectified_too, HEAD),
        (tutorial, HEAD), (camera_and_projector, ALONE), (matlab, HEAD), (plain_json, HEAD), (counted_from_nought, HEAD), (poses, HEAD),
        (named_turn, HEAD), (a_list_of_tables, HEAD), (two_ways_of_which_one_is_named, HEAD), (lines_below_names, HEAD), (slmaster, ALONE),
    ],
)  # fmt: skip
def test_numbers_are_those_of_the_file_in_which_they_stand(
    write: Callable[[Path], str], head: str, tmp_path: Path
) -> None:
    found = rig(tmp_path, write(tmp_path), head=head)
    point = (30.0, -20.0, 650.0)
    np.testing.assert_allclose(projected(found, point), expected(point), atol=1e-6)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"K1": M1 * np.array([[1.1], [1], [1]])}, "s.yml: M1 and s.yml: K1 say the matrix of left differently"),
        ({"rvec": np.array([0.01, -0.2, 0.05])}, "s.yml: R and s.yml: rvec say the rotation of both differently"),
        ({"R1": WORLD_R, "T1": WORLD_T, "R2": R.T @ WORLD_R, "T2": R @ WORLD_T + T},
         "s.yml: R and s.yml: R1 with s.yml: R2 say differently how the two stand to each other: turned by 23"),
        ({"S": np.array([320.0, 240.0])},
         "s.yml: S says 320 x 240 px, and the left images have 640 x 480 px: a calibration of images of half the size; give"),
        ({"image_width": 640, "image_height": 512}, "s.yml: image_width, image_height says 640 x 512 px, and the left images have 640 x 480 px: another"),
        ({"proj_K": M2, "M2": None}, "s.yml: proj_K is a projector's, and the images are of two cameras"),
        ({"T": 1640.0 * T}, "the two are 1.65e+05 mm apart; allowed: 1 mm to 20 m; say in which unit"),
        ({"T": 0.001 * T}, 'the two are 0.101 mm apart; allowed: 1 mm to 20 m; say in which unit the translation is: cameras.unit = "m"'),
    ],
)  # fmt: skip
def test_what_is_said_twice_and_differs_is_refused(tmp_path: Path, values: dict[str, Any], said: str) -> None:
    every = {"M1": M1, "D1": D1, "M2": M2, "D2": D2, "R": R, "T": T, **values}
    written(tmp_path / "s.yml", **{name: value for name, value in every.items() if value is not None})
    with pytest.raises(ForeignError) as error:
        rig(tmp_path, 'files = "s.yml"')
    assert said in str(error.value)


SLSTUDIO = {"Kc": M1, "kc": D1, "Kp": M2, "kp": D2, "Rp": R, "Tp": T, "frameWidth": 640, "frameHeight": 480}
OPENCV = {"M1": M1, "D1": D1, "M2": M2, "D2": D2, "R": R, "T": T}


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
    ("more", "known", "length", "noted"),
    [
        ("", False, 1.0, "lengths are in distances of the two"),
        ('unit = "m"', True, 1000.0, "the translation is 1 m long"),
    ],
)
def test_a_translation_of_length_one_has_no_scale(
    tmp_path: Path, more: str, known: bool, length: float, noted: str
) -> None:
    written(tmp_path / "s.yml", M1=M1, D1=D1, M2=M2, D2=D2, R=R, T=T / np.linalg.norm(T) * 1.0004)
    found = rig(tmp_path, f'files = "s.yml"\n{more}')
    assert found.scale_known is known
    assert np.linalg.norm(found.rig.right.translation_mm) == pytest.approx(length, rel=1e-3)
    assert [note for note in found.notes if noted in note] == list(found.notes)


def test_a_principal_point_far_from_the_middle_is_worth_a_line(tmp_path: Path) -> None:
    written(tmp_path / "s.yml", M1=M1, D1=D1, M2=M2 + np.array([[0, 0, 0], [0, 0, 206.0], [0, 0, 0]]), D2=D2, R=R, T=T)
    assert rig(tmp_path, 'files = "s.yml"').notes == (
        "cameras.right.matrix: the principal point is at 95 % of the height: a shifted lens, or the calibration of other images",
    )


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


def of_length(folder: Path, length: float) -> str:
    written(folder / "c.yml", M1=M1, D1=D1, M2=M2, D2=D2, R=R, T=length * T / np.linalg.norm(T))
    return 'files = "c.yml"'


@pytest.mark.parametrize(("unit", "mm"), [("cm", 10.0), ("inch", 25.4)])
def test_lengths_become_millimetres(unit: str, mm: float, tmp_path: Path) -> None:
    found = rig(tmp_path, f'{of_length(tmp_path, 100.0 / mm)}\nunit = "{unit}"')
    assert np.linalg.norm(found.rig.right.translation_mm) == pytest.approx(100.0, rel=1e-9)


def unknown_names(folder: Path) -> str:
    written(folder / "c.yml", eye_a=M1, eye_b=M2, twist=R, shift=T)
    return 'files = "c.yml"'


@pytest.mark.parametrize(
    ("write", "unit"),
    [(in_folders, "mm"), (of_the_world, "mm"), (slmaster, "mm"), (partial(of_length, length=0.1), "m"),
     (partial(of_length, length=2.9), "m"), (partial(of_length, length=3.1), "mm"), (unknown_names, "mm")],
)  # fmt: skip
def test_camera_files_are_found_in_a_folder(write: Callable[[Path], str], unit: str, tmp_path: Path) -> None:
    wanted = tomllib.loads(write(tmp_path))["files"]
    (tmp_path / "notes.txt").write_text("exposure = 12\n1 2 3\n")
    np.savez(tmp_path / "points.npz", xyz=np.zeros((40, 3)), size=np.array([4.0, 4.0]))
    found = cameras_in(tmp_path)
    assert sorted(found["files"]) == sorted([wanted] if isinstance(wanted, str) else wanted)
    assert found["unit"] == unit


def test_our_own_calibration_is_found_first(tmp_path: Path) -> None:
    assert cameras_in(tmp_path) == {}
    found = rig(tmp_path, in_folders(tmp_path), head=ALONE)
    mine = Calibration("pair", IN_AIR, "unknown", ("pictures",), Water(20.0, 0.0, 530.0), found.rig)
    (tmp_path / "pair.json").write_bytes(encode(mine))
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


def test_a_principal_point_beside_the_image_is_a_shifted_lens(tmp_path: Path) -> None:
    shifted = M2 + np.array([[0, 0, 0], [0, 0, 450.0], [0, 0, 0]])
    written(tmp_path / "c.yml", M1=M1, D1=D1, M2=shifted, D2=D2, R=R, T=T)
    point = (10.0, 20.0, 600.0)
    wanted = expected(point) + np.array([0.0, 0.0, 0.0, 450.0])
    np.testing.assert_allclose(projected(rig(tmp_path, 'files = "c.yml"'), point), wanted, atol=1e-6)
