"""What strangers bring, damaged or in another's hand, is read or refused by its name: descriptions, and the files of their cameras."""

from __future__ import annotations

import io
import json
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import strategies as st
from scipy.io import savemat

from appliance.desk.foreign.camera_files import FORMATS, numbers_in
from appliance.desk.foreign.cameras import read_rig
from appliance.desk.foreign.description import load_description, parse_description, with_counts
from appliance.desk.foreign.problem import ForeignError
from tests.appliance.desk.foreign.test_cameras import D1, HEAD, M1, OPENCV, SIZES, R, T
from tests.support.damage import Parser, changed, damaged, toml_of

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
KEYS = tuple(sorted({key for table in TREE.values() if isinstance(table, dict) for key in table} | set(TREE)))
ORDERS = (
    "gray-x*5", "(gray-x", "gray-x)*3", "sine-x9*4", "((((gray-x*9)*9)*9)*9)*9", "*4", "sine-x*0", "- - -", "~sine-x", "gray-z", "",
    "bright bright", "gray-x*" + "9" * 40, "(" * 60 + ")" * 60, "sine-x*17", "gray-x*20",
)  # fmt: skip
DESCRIPTIONS = st.one_of(
    changed(TREE, KEYS).map(lambda tree: toml_of(tree).encode("utf-8", "surrogatepass")),
    st.sampled_from(ORDERS).map(lambda order: toml_of({**TREE, "images": {**TREE["images"], "order": order}}).encode()),
    damaged([TEXT.encode()]),
)


def read_description(data: bytes, folder: Path) -> None:
    (folder / "set.toml").write_bytes(data)
    said = load_description(folder / "set.toml")
    assert said.axes
    for axis in said.axes:
        assert len(axis.periods_px) == len(axis.steps_deg)
        assert axis.periods_px or axis.stripe_px > 0.0
    try:
        if said.order is not None:
            with_counts(said, said.order)
        read_rig(said, SIZES)
    except ForeignError as error:
        raise ForeignError(f"set.toml: {error}") from error


ROS = b"""camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [800.0, 0, 320, 0, 810, 240, 0, 0, 1]
distortion_coefficients: {rows: 1, cols: 5, data: [0, 0, 0, 0, 0]}
R: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
"""
KALIBR = b"""cam0:
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
MIDDLEBURY = b"cam0=[900 0 311; 0 900 254; 0 0 1]\ncam1=[900 0 342; 0 900 254; 0 0 1]\ndoffs=31\nbaseline=193\n"


def by_opencv(suffix: str) -> bytes:
    storage = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, value in OPENCV.items():
        storage.write(name, value)
    return storage.releaseAndGetString().encode()


def bytes_of(write: Callable[..., None], *args: Any, **arrays: Any) -> bytes:
    with io.BytesIO() as file:
        write(file, *args, **arrays)
        return file.getvalue()


ONE = {"IntrinsicMatrix": M1.T, "RadialDistortion": D1[0, :2], "TangentialDistortion": D1[0, 2:4]}
STRUCTURE = {"CameraParameters1": ONE, "CameraParameters2": ONE, "RotationOfCamera2": R.T, "TranslationOfCamera2": T.T}
TOOLBOX = {"KK_left": M1, "kc_left": D1, "KK_right": M1, "kc_right": D1, "R": R, "T": T, "rig": {"n": [1, 2, 3]}}
MATLAB = (bytes_of(savemat, TOOLBOX), bytes_of(savemat, {"s": STRUCTURE}))
QUICK = (
    *((suffix, by_opencv(suffix)) for suffix in (".yml", ".xml", ".json")), (".yaml", ROS), (".yaml", KALIBR), (".txt", MIDDLEBURY),
    (".npz", bytes_of(np.savez, **OPENCV)), (".npy", bytes_of(np.save, M1)),
    (".json", json.dumps({name: value.tolist() for name, value in OPENCV.items()}).encode()),
)  # fmt: skip
CAMERA_FILES = st.one_of(
    st.sampled_from(QUICK),
    *(st.tuples(st.just(suffix), damaged([data])) for suffix, data in QUICK),
    st.tuples(st.sampled_from(tuple(sorted(FORMATS.keys() - {".mat"}))), damaged([data for _, data in QUICK])),
)


def read_cameras(case: tuple[str, bytes], folder: Path) -> None:
    suffix, data = case
    path = folder / f"cameras{suffix}"
    path.write_bytes(data)
    for name, numbers in numbers_in(path).items():
        assert name
        assert numbers.dtype == np.float64
    rig = read_rig(
        parse_description(f'{HEAD}[cameras]\nfiles = "cameras{suffix}"\n', folder, "set", "set.toml"), SIZES
    ).rig
    assert np.isfinite(rig.right.rotation).all()
    assert np.isfinite(rig.right.translation_mm).all()


PARSERS = (
    Parser("description", DESCRIPTIONS, read_description, (ForeignError,), "set.toml"),
    Parser("cameras", CAMERA_FILES, read_cameras, (ForeignError,), "cameras"),
    # Each is read in a process of its own, which costs a thousand others.
    Parser("matlab", st.tuples(st.just(".mat"), st.sampled_from(MATLAB) | damaged(MATLAB)), read_cameras, (ForeignError,), "cameras", share=0.05),
)  # fmt: skip


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("parser", PARSERS, ids=lambda parser: parser.name)
def test_whatever_a_stranger_brings_is_read_or_refused_by_name(parser: Parser, tmp_path: Path) -> None:
    assert parser.judge(tmp_path)["accepted"], "nothing behind the first check was reached"
