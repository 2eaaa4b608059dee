"""What strangers bring: descriptions of their images, and the files of their cameras, after damage or in another's hand."""

from __future__ import annotations

import io
import json
import tempfile
import tomllib
from pathlib import Path
from random import Random
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.io import savemat

from appliance.foreign.camera_files import FORMATS, numbers_in
from appliance.foreign.cameras import read_rig
from appliance.foreign.description import counted, load_description, parse_description
from appliance.foreign.problem import ForeignError
from tests.fuzz.damage import changed, damaged
from tests.fuzz.target import Target
from tests.fuzz.toml import toml_of

# ------------------------------------------------------------------------------------------------ descriptions

TEXT = """
name = "bust"
[images]
left = "left/*.png"
right = ["right/a*.png", "right/b*.png"]
order = "bright dark (gray-x ~gray-x)*6 sine-x*4 sine-x2*4 - gray-y*5 sine-y*3"
channel = "green"
white = 4095
[projector]
width_px = 1024
height_px = 768
[x]
period_px = [32, 36.5]
steps = 4
sign = "-"
start_deg = 90
gray = "complementary"
[y]
fringes = 24
steps_deg = [0, 120, 240]
stripe_px = 32
code_offset_px = -16
code = "binary"
code_order = "fine-first"
code_inverted = true
[cameras]
unit = "cm"
rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
translation = [-12.0, 0.1, 0.5]
[cameras.left]
matrix = [[800, 0, 320], [0, 810, 240], [0, 0, 1]]
distortion = [-0.1, 0.02, 0, 0]
[cameras.right]
matrix = [[790, 0, 310], [0, 795, 250], [0, 0, 1]]
[water]
temperature_c = 12
salinity_psu = 35
[ports]
distance_mm = 20
thickness_mm = 5
glass_index = 1.5
left_normal = [0, 0.01, 1]
[range]
near_mm = 300
far_mm = 900
"""
TREE = tomllib.loads(TEXT)
WORDS = tuple(sorted({key for table in TREE.values() if isinstance(table, dict) for key in table} | set(TREE)))
ORDERS = (
    "gray-x*5", "(gray-x", "gray-x)*3", "sine-x9*4", "((((gray-x*9)*9)*9)*9)*9", "*4", "sine-x*0", "- - -", "~sine-x", "gray-z", "",
    "bright bright", "gray-x*" + "9" * 40, "(" * 60 + ")" * 60, "sine-x*17", "gray-x*20",
)  # fmt: skip


def _description(chance: Random) -> bytes:
    if chance.random() < 0.15:
        tree = tomllib.loads(TEXT)
        tree["images"]["order"] = chance.choice(ORDERS)
        return toml_of(tree).encode()
    if chance.random() < 0.7:
        return toml_of(changed(chance, TREE, WORDS)).encode("utf-8", "surrogatepass")
    return damaged(chance, TEXT.encode(), (TEXT.encode(),))


SIZES_PX = {"left": (640, 480), "right": (640, 480)}


def _read_description(data: bytes, scratch: Path) -> None:
    path = scratch / "set.toml"
    path.write_bytes(data)
    said = load_description(path)
    assert said.axes
    for axis in said.axes:
        assert len(axis.periods_px) == len(axis.steps_deg)
        assert axis.periods_px or axis.stripe_px > 0.0
    try:
        if said.order is not None:
            counted(said, said.order)
        read_rig(said, SIZES_PX)
    except ForeignError as error:
        raise ForeignError(f"set.toml: {error}") from error


# ------------------------------------------------------------------------------------------------ camera files

K = np.array([[800.0, 0, 320], [0, 810, 240], [0, 0, 1]])
D = np.array([[-0.1, 0.05, 0.001, -0.002, 0.01]])
R = cv2.Rodrigues(np.array([0.01, -0.2, 0.03]))[0]
T = np.array([[-100.0], [2.0], [10.0]])
NUMBERS: dict[str, NDArray[Any]] = {"M1": K, "D1": D, "M2": K, "D2": D, "R": np.asarray(R), "T": T}
ROS = """camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [800.0, 0, 320, 0, 810, 240, 0, 0, 1]
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
R: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
"""


KALIBR = """cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.1, 0.05, 0.001, -0.002]
  distortion_model: radtan
  intrinsics: [800.0, 810.0, 320.0, 240.0]
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.1]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  intrinsics: [800.0, 810.0, 320.0,
    240.0]
"""
MIDDLEBURY = "cam0=[900 0 311; 0 900 254; 0 0 1]\ncam1=[900 0 342; 0 900 254; 0 0 1]\ndoffs=31\nbaseline=193\n"


def _written() -> tuple[tuple[str, bytes], ...]:
    """Files as their own programs write them."""
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for suffix in (".yml", ".xml", ".json"):
            path = Path(folder) / f"cameras{suffix}"
            storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
            for name, value in NUMBERS.items():
                storage.write(name, value)
            storage.release()
            found.append((suffix, path.read_bytes()))
    plain = json.dumps({name: value.tolist() for name, value in NUMBERS.items()}).encode()
    archive, matlab = io.BytesIO(), io.BytesIO()
    np.savez(archive, M1=K, D1=D, M2=K, D2=D, R=R, T=T)
    savemat(matlab, {"KK_left": K, "kc_left": D, "KK_right": K, "kc_right": D, "R": R, "T": T, "rig": {"n": [1, 2, 3]}})
    structure, single = io.BytesIO(), io.BytesIO()
    one = {"IntrinsicMatrix": K.T, "RadialDistortion": D[0, :2], "TangentialDistortion": D[0, 2:4]}
    rig = {"CameraParameters1": one, "CameraParameters2": one, "RotationOfCamera2": R.T, "TranslationOfCamera2": T.T}
    savemat(structure, {"s": rig})
    np.save(single, K)
    return (
        *found,
        (".json", plain),
        (".yaml", ROS.encode()),
        (".npz", archive.getvalue()),
        (".mat", matlab.getvalue()),
        (".mat", structure.getvalue()),
        (".yaml", KALIBR.encode()),
        (".txt", MIDDLEBURY.encode()),
        (".npy", single.getvalue()),
    )


FILES = _written()
HEAD = """
[images]
left = "l*"
right = "r*"
order = "gray-x*8"
[projector]
width_px = 1024
height_px = 768
[x]
stripe_px = 4
[cameras]
"""


def _camera_file(chance: Random) -> tuple[str, bytes]:
    # MATLAB's files are read in a process of their own, which costs a thousand others.
    quick = [one for one in FILES if one[0] != ".mat" or chance.random() < 0.02]
    suffix, data = chance.choice(quick)
    if chance.random() < 0.02:
        suffix = chance.choice(tuple(FORMATS))
    return suffix, damaged(chance, data, tuple(one for _, one in FILES)) if chance.random() < 0.9 else data


def _read_cameras(case: tuple[str, bytes], scratch: Path) -> None:
    suffix, data = case
    path = scratch / f"cameras{suffix}"
    path.write_bytes(data)
    for name, numbers in numbers_in(path).items():
        assert name
        assert numbers.dtype == np.float64
    rig = read_rig(parse_description(f'{HEAD}files = "cameras{suffix}"\n', scratch, "set", "set.toml"), SIZES_PX).rig
    assert np.isfinite(rig.right.rotation).all()
    assert np.isfinite(rig.right.translation_mm).all()


TARGETS = (
    Target("description", "a description of another's images", _description, _read_description, (ForeignError,), "set.toml", cost=3.0),
    Target("cameras", "the files of another's cameras", _camera_file, _read_cameras, (ForeignError,), "cameras", cost=8.0),
)  # fmt: skip
