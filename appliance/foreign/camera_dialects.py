"""Owns other programs' ways of saying two cameras, put into OpenCV's names: Kalibr, MATLAB, Bouguet's toolbox, SLStudio, Middlebury.

Whatever they say otherwise is undone here: MATLAB counts pixels from 1 and multiplies from the right, Kalibr has one matrix of 4 x 4 for
rotation and translation, Middlebury's images are rectified, and fisheye models are refused by their names.
Sources: Kalibr's wiki, "Yaml formats"; MathWorks, ``stereoParametersToOpenCV`` and "How do I transform points in camera 1 coordinates to
camera 2 coordinates?"; J.-Y. Bouguet, Camera Calibration Toolbox for Matlab; SLStudio's CalibrationData; Middlebury Stereo 2014, calib.txt.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance.foreign.problem import ForeignError

Array = NDArray[np.float64]

PINHOLES = ("pinhole", "")
DISTORTIONS = ("radtan", "plumb_bob", "plumb-bob", "rational_polynomial", "none", "brown", "opencv", "")
"""Models of distortion that OpenCV's numbers describe."""


def in_opencvs_names(source: str, values: Mapping[str, Array], words: Mapping[str, str]) -> dict[str, Array]:
    """Return the numbers of a file by names of OpenCV's, where another program's names are known, else as they are.

    ``words`` are its texts by name. Raises ForeignError, which begins with ``source``, for a model of lenses that is no pinhole with
    OpenCV's distortion.
    """
    _refuse_other_lenses(source, words)
    found = dict(values)
    for dialect in (_kalibr, _matlab, _bouguet, _slstudio, _middlebury):
        for name, numbers in dialect(values):
            found.pop(name, None)
            if numbers is not None:
                found[name] = numbers
    return found


def _refuse_other_lenses(source: str, words: Mapping[str, str]) -> None:
    for name, word in words.items():
        last = name.rpartition(".")[2].lower()
        allowed = {"camera_model": PINHOLES, "distortion_model": DISTORTIONS}.get(last)
        if allowed is not None and word.lower() not in allowed:
            raise ForeignError(
                f"{source}: {name} is {word!r:.40}; allowed: {', '.join(one for one in allowed if one)}; fisheye and other lenses are not "
                "read: calibrate with OpenCV's model, or undistort the images and give the matrices of these"
            )


def _camera(f_px: Any, c_px: Any, skew: float = 0.0) -> Array:
    f, c = np.ravel(f_px), np.ravel(c_px)
    return np.array([[f[0], skew, c[0]], [0.0, f[-1], c[1]], [0.0, 0.0, 1.0]])


Names = Iterator[tuple[str, Array | None]]
"""Names with their numbers; ``None``: the name is taken away, since it means something else elsewhere."""


def _kalibr(values: Mapping[str, Array]) -> Names:
    for name, numbers in values.items():
        found = re.fullmatch(r"(?:.*\.)?cam(\d)\.intrinsics", name)
        if found is None or numbers.size != 4:
            continue
        before, side = name.removesuffix("intrinsics"), "left" if found[1] == "0" else "right"
        yield name, None
        yield f"K_{side}", _camera(numbers.ravel()[:2], numbers.ravel()[2:])
        distortion = values.get(f"{before}distortion_coeffs")
        if distortion is not None:
            yield f"{before}distortion_coeffs", None
            yield f"D_{side}", distortion
        pose = values.get(f"{before}T_cn_cnm1")
        if pose is not None and pose.size == 16:
            # A point of the camera before into this one.
            yield "R", pose.reshape(4, 4)[:3, :3]
            yield "T", pose.reshape(4, 4)[:3, 3]


def _matlab(values: Mapping[str, Array]) -> Names:
    """``toStruct(stereoParams)``: matrices that rows are multiplied by, pixels that are counted from 1."""
    for name in values:
        found = re.fullmatch(r"((?:.*\.)?)CameraParameters([12])\.(IntrinsicMatrix|K)", name)
        if found is None or values[name].size != 9:
            continue
        before, side = f"{found[1]}CameraParameters{found[2]}.", "left" if found[2] == "1" else "right"
        matrix = values[name].reshape(3, 3).copy()
        matrix = matrix.T if abs(matrix[2, 0]) > abs(matrix[0, 2]) else matrix
        matrix[:2, 2] -= 1.0
        yield name, None
        yield f"K_{side}", matrix
        radial = np.zeros(3)
        given = np.ravel(values.get(f"{before}RadialDistortion", np.zeros(2)))[:3]
        radial[: given.size] = given
        across = np.ravel(values.get(f"{before}TangentialDistortion", np.zeros(2)))
        yield f"D_{side}", np.array([radial[0], radial[1], *across[:2], radial[2]])
        rotation, translation = (values.get(f"{found[1]}{what}OfCamera2") for what in ("Rotation", "Translation"))
        if rotation is not None and translation is not None and rotation.size == 9:
            yield "R", rotation.reshape(3, 3).T
            yield "T", translation.ravel()


def _bouguet(values: Mapping[str, Array]) -> Names:
    """``fc`` and ``cc`` of each camera, with ``alpha_c`` for a skew in units of the focal length."""
    for name, focal in values.items():
        found = re.fullmatch(r"((?:.*\.)?)fc(_?\w*)", name)
        centre = None if found is None else values.get(f"{found[1]}cc{found[2]}")
        if found is None or centre is None or focal.size != 2 or centre.size != 2:
            continue
        skew = np.ravel(values.get(f"{found[1]}alpha_c{found[2]}", np.zeros(1)))
        matrix = _camera(focal, centre, float(skew[0] * focal.ravel()[0]))
        yield f"{found[1]}KK{found[2]}", matrix
        yield name, None
        yield f"{found[1]}cc{found[2]}", None


def _slstudio(values: Mapping[str, Array]) -> Names:
    """``Kc kc Kp kp Rp Tp``: camera and projector differ in the case of a letter from matrix and distortion."""
    if not {"Kc", "kc", "Kp", "kp", "Rp", "Tp"} <= set(values):
        return
    for theirs, ours in (
        ("Kc", "cam_K"),
        ("kc", "cam_kc"),
        ("Kp", "proj_K"),
        ("kp", "proj_kc"),
        ("Rp", "R"),
        ("Tp", "T"),
    ):
        yield theirs, None
        yield ours, values[theirs]


def _middlebury(values: Mapping[str, Array]) -> Names:
    """Rectified cameras side by side: ``cam0``, ``cam1`` and ``baseline``."""
    baseline = values.get("baseline")
    if (
        baseline is None
        or baseline.size != 1
        or any(values.get(name, np.empty(0)).size != 9 for name in ("cam0", "cam1"))
    ):
        return
    yield "R", np.eye(3)
    yield "T", np.array([-float(baseline.ravel()[0]), 0.0, 0.0])
