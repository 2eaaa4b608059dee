"""Cameras as other programs write them: each file, as its program's manual has it, gives the cameras of the numbers that were put in."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.io import savemat

from appliance.foreign.camera_files import numbers_in
from appliance.foreign.cameras import ForeignRig, read_rig
from appliance.foreign.description import parse_description
from appliance.foreign.problem import ForeignError

SIZES = {"left": (640, 480), "right": (640, 480)}
K1 = np.array([[800.0, 0, 320], [0, 810, 240], [0, 0, 1]])
K2 = np.array([[790.0, 0, 310], [0, 795, 250], [0, 0, 1]])
D1, D2 = np.array([-0.1, 0.05, 0.001, -0.002, 0.0]), np.array([-0.08, 0.02, 0.0, 0.0, 0.0])
R = np.asarray(cv2.Rodrigues(np.array([0.01, -0.2, 0.03]))[0])
T = np.array([-100.0, 2.0, 10.0])
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
POINTS = np.array([[0.0, 0.0, 500.0], [60.0, -40.0, 700.0], [-80.0, 50.0, 400.0]])


def rig(folder: Path, files: list[str], unit: str = "mm", head: str = HEAD) -> ForeignRig:
    text = f'{head}[cameras]\nfiles = {json.dumps(files)}\nunit = "{unit}"\n'
    return read_rig(parse_description(text, folder, "set", "set.toml"), SIZES)


def rows(values: Any, indent: str = "  ") -> str:
    """A matrix as PyYAML writes nested lists: each row's dash at the level of the key."""
    return "\n".join(f"{indent}- [{', '.join(f'{one:.12g}' for one in row)}]" for row in np.atleast_2d(values))


def flat(values: Any) -> str:
    return ", ".join(f"{one:.12g}" for one in np.ravel(values))


def kalibr(folder: Path, model: str = "radtan") -> list[str]:
    pose = np.vstack([np.column_stack([R, 0.001 * T]), [0.0, 0.0, 0.0, 1.0]])
    said = []
    for n, (K, D) in enumerate(((K1, D1), (K2, D2))):
        said.append(f"cam{n}:")
        if n:
            said.append(f"  T_cn_cnm1:\n{rows(pose)}")
        said.append(
            f"  cam_overlaps: [{1 - n}]\n  camera_model: pinhole\n  distortion_coeffs: [{flat(D[:4])}]\n  distortion_model: {model}\n"
            f"  intrinsics: [{flat((K[0, 0], K[1, 1], K[0, 2], K[1, 2]))}]\n  resolution: [640, 480]\n  rostopic: /cam{n}/image_raw"
        )
    (folder / "camchain.yaml").write_text("\n".join(said) + "\n")
    return ["camchain.yaml"]


def ros(folder: Path) -> list[str]:
    """``camera_info`` of both: the pose is in what rectifies them."""
    R1, R2, P1, P2 = cv2.stereoRectify(K1, D1, K2, D2, (640, 480), R, 0.001 * T[:, None])[:4]
    for side, K, D, turn, P in (("left", K1, D1, R1, P1), ("right", K2, D2, R2, P2)):
        parts = {
            "camera_matrix": K,
            "distortion_coefficients": D[None],
            "rectification_matrix": turn,
            "projection_matrix": P,
        }
        said = [f"image_width: 640\nimage_height: 480\ncamera_name: {side}\ndistortion_model: plumb_bob"]
        said += [
            f"{name}:\n  rows: {m.shape[0]}\n  cols: {m.shape[1]}\n  data: [{flat(m)}]" for name, m in parts.items()
        ]
        (folder / f"{side}.yaml").write_text("\n".join(said) + "\n")
    return ["right.yaml", "left.yaml"]


def pyyaml(folder: Path) -> list[str]:
    """``yaml.dump`` of lists of lists: a dash before a dash, nothing indented."""
    said = []
    for name, values in (("camera_matrix_left", K1), ("dist_coeff_left", D1[None]), ("camera_matrix_right", K2),
                         ("dist_coeff_right", D2[None]), ("R", R), ("T", T[:, None])):  # fmt: skip
        said.append(f"{name}:")
        said += [
            "\n".join(f"{'- -' if k == 0 else '  -'} {one!r}" for k, one in enumerate(row.tolist())) for row in values
        ]
    (folder / "stereo.yaml").write_text("\n".join(said) + "\n")
    return ["stereo.yaml"]


def matlab_struct() -> dict[str, Any]:
    """``toStruct(stereoParams)``: pixels from 1, rows times matrices."""
    cameras = {}
    for n, (K, D) in enumerate(((K1, D1), (K2, D2)), 1):
        from_one = K + np.array([[0, 0, 1.0], [0, 0, 1.0], [0, 0, 0]])
        cameras[f"CameraParameters{n}"] = {
            "RadialDistortion": D[:2], "TangentialDistortion": D[2:4], "ImageSize": np.array([480.0, 640.0]),
            "IntrinsicMatrix": from_one.T, "WorldUnits": "mm", "EstimateSkew": False,
        }  # fmt: skip
    return {**cameras, "RotationOfCamera2": R.T, "TranslationOfCamera2": T, "Version": {"Major": 1.0}}


def matlab(folder: Path) -> list[str]:
    savemat(folder / "stereo.mat", {"s": matlab_struct()}, do_compression=True)
    return ["stereo.mat"]


def matlab_json(folder: Path) -> list[str]:
    said = json.dumps(matlab_struct(), default=lambda one: one.tolist())
    (folder / "stereo.json").write_text(said)
    return ["stereo.json"]


def bouguet(folder: Path) -> list[str]:
    values: dict[str, Any] = {
        "om": cv2.Rodrigues(R)[0],
        "R": R,
        "T": T[:, None],
        "nx": 640.0,
        "recompute_intrinsic_left": 1.0,
    }
    for side, K, D in (("left", K1, D1), ("right", K2, D2)):
        values |= {
            f"fc_{side}": K[[0, 1], [0, 1]][:, None],
            f"cc_{side}": K[:2, 2:],
            f"kc_{side}": D[:, None],
            f"alpha_c_{side}": 0.0,
        }
    savemat(folder / "Calib_Results_stereo.mat", values)
    return ["Calib_Results_stereo.mat"]


def slstudio(folder: Path) -> list[str]:
    storage = cv2.FileStorage(str(folder / "calibration.xml"), cv2.FILE_STORAGE_WRITE)
    for name, value in (("Kc", K1), ("kc", D1), ("Kp", K2), ("kp", D2), ("Rp", R), ("Tp", T), ("cam_error", 0.2)):
        storage.write(name, value)
    storage.release()
    return ["calibration.xml"]


def renderings(folder: Path) -> list[str]:
    """By Blender: of each device its place in the world, and the turn of the world into it."""
    for name, K, D, turn, t in (("camera", K1, D1, np.eye(3), np.zeros(3)), ("projector", K2, D2, R, T)):
        rotate, translate = cv2.Rodrigues(turn)[0].ravel(), -turn.T @ t
        said = {"image_size": [640, 480], "intrinsic": K, "distortion": D, "rotate": rotate, "translate": translate}
        (folder / f"{name}.json").write_text(json.dumps(said, default=lambda one: one.tolist()))
    return ["camera.json", "projector.json"]


def a_file_for_each(folder: Path) -> list[str]:
    """As ``np.save`` and ``np.savetxt`` leave them."""
    np.save(folder / "mtx_left.npy", K1)
    np.save(folder / "dist_left.npy", D1[None])
    np.savetxt(folder / "K_right.txt", K2)
    np.savetxt(folder / "D_right.csv", D2[None], delimiter=",")
    np.savetxt(folder / "R.txt", R)
    np.savetxt(folder / "T.txt", T[:, None])
    return ["mtx_left.npy", "dist_left.npy", "K_right.txt", "D_right.csv", "R.txt", "T.txt"]


def opencv_without_its_first_line(folder: Path) -> list[str]:
    said = [
        f"{name}: !!opencv-matrix\n   rows: {m.shape[0]}\n   cols: {m.shape[1]}\n   dt: d\n   data: [ {flat(m)} ]"
        for name, m in (("M1", K1), ("D1", D1[None]), ("M2", K2), ("D2", D2[None]), ("R", R), ("T", T[:, None]))
    ]
    (folder / "stereo.yml").write_text("---\n" + "\n".join(said) + "\n")
    return ["stereo.yml"]


@pytest.mark.parametrize(
    ("write", "unit"),
    [
        (kalibr, "m"), (ros, "m"), (pyyaml, "mm"), (matlab, "mm"), (matlab_json, "mm"), (bouguet, "mm"), (slstudio, "mm"),
        (renderings, "mm"), (a_file_for_each, "mm"), (opencv_without_its_first_line, "mm"),
    ],
)  # fmt: skip
def test_another_programs_file_projects_as_its_cameras_do(
    tmp_path: Path, write: Callable[[Path], list[str]], unit: str
) -> None:
    head = HEAD if write not in (slstudio, renderings) else HEAD.replace('right = "r*"\n', "")
    found = rig(tmp_path, write(tmp_path), unit, head)
    for point in POINTS:
        for camera, turn, t, K, D in (
            (found.rig.left, np.eye(3), np.zeros(3), K1, D1),
            (found.rig.right, R, T, K2, D2),
        ):
            wanted = cv2.projectPoints(point[None], cv2.Rodrigues(turn)[0], t, K, D)[0].ravel()
            np.testing.assert_allclose(camera.project(point, found.index), wanted, atol=1e-5)


def test_rectified_images_of_middlebury_are_side_by_side(tmp_path: Path) -> None:
    (tmp_path / "calib.txt").write_text(
        "cam0=[900.5 0 311.2; 0 900.5 254.8; 0 0 1]\ncam1=[900.5 0 342.3; 0 900.5 254.8; 0 0 1]\ndoffs=31.1\nbaseline=193.0\n"
        "width=640\nheight=480\nndisp=290\nisint=0\nvmin=23\nvmax=225\n"
    )
    found = rig(tmp_path, ["calib.txt"])
    left, right = (one.project(np.array([30.0, -20.0, 2000.0]), 1.0) for one in (found.rig.left, found.rig.right))
    # z = baseline · f / (disparity + doffs), as Middlebury's page says.
    assert 193.0 * 900.5 / (left[0] - right[0] + 31.1) == pytest.approx(2000.0, abs=1e-6)
    assert left[1] == pytest.approx(right[1], abs=1e-9)


@pytest.mark.parametrize(
    ("write", "said"),
    [
        (lambda folder: kalibr(folder, "equidistant"), "cam0.distortion_model is 'equidistant'; allowed: radtan"),
        (lambda folder: _text(folder, "cameras.txt", "# Camera list\n1 OPENCV 640 480 800 810 320 240 0 0 0 0\n"),
         "no line is NAME = NUMBERS, and it is no matrix); correct it, or write the matrices under [cameras.left]"),
        (lambda folder: _text(folder, "s.yaml", "a:\n- [1, 2\nb: 3\n"), "not readable as YAML or XML (while parsing a flow sequence"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_says_what_to_write(tmp_path: Path, write: Callable[[Path], list[str]], said: str) -> None:
    with pytest.raises(ForeignError) as error:
        rig(tmp_path, write(tmp_path))
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("name", "text", "wanted"),
    [
        ("s.json", '{"a": [1, 2], "a": [1, 2], "__b": 3, "c": "4"}', {"a": [1, 2]}),
        ("s.json", '{"a": [1, 2], "a": [1, 3]}', "a stands there twice, and differs"),
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
        ("s.xml", " <!DOCTYPE a><a><b>1</b></a>", "it defines what it consists of"),
        ("s.txt", "1 2 # 9\n# 8\n3;4\nK = [5, 6; 7 8]\n(9)\nfree: text\n10\n", {"s": [1, 2, 3, 4], "K": [5, 6, 7, 8, 9], "free": [10]}),
    ],
)  # fmt: skip
def test_numbers_of_a_text_have_names_or_it_says_why_not(
    tmp_path: Path, name: str, text: str, wanted: dict[str, Any] | str
) -> None:
    _text(tmp_path, name, text)
    if isinstance(wanted, str):
        with pytest.raises(ForeignError, match=f"not readable as .* [(]{wanted}[)]; correct it"):
            numbers_in(tmp_path / name)
    else:
        assert {name: array.tolist() for name, array in numbers_in(tmp_path / name).items()} == wanted


def test_metres_taken_for_millimetres_are_noticed(tmp_path: Path) -> None:
    with pytest.raises(ForeignError, match=r'the two are 0.101 mm apart; .* cameras.unit = "m"'):
        rig(tmp_path, kalibr(tmp_path))


def _text(folder: Path, name: str, text: str) -> list[str]:
    (folder / name).write_text(text)
    return [name]


def test_an_object_of_matlabs_own_says_how_to_save_it(tmp_path: Path) -> None:
    """``save stereo.mat stereoParams``: an array of class 17, which nobody but MATLAB reads."""
    flags = struct.pack("<IIII", 6, 8, 17, 0)
    names = b"".join(
        struct.pack("<II", 1, len(text)) + text + b"\0" * (-len(text) % 8)
        for text in (b"stereoParams", b"MCOS", b"stereoParameters")
    )
    content = struct.pack("<8I", 6, 8, 13, 0, 5, 8, 1, 1) + struct.pack("<6I", 1, 0, 6, 4, 7, 0)
    body = flags + names + struct.pack("<II", 14, len(content)) + content
    header = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    (tmp_path / "stereo.mat").write_bytes(header + struct.pack("<II", 14, len(body)) + body)
    with pytest.raises(ForeignError, match=r"save it as a structure, s = toStruct\(stereoParams\)"):
        rig(tmp_path, ["stereo.mat"])
