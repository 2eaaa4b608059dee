"""Owns the cameras of a foreign rig: from OpenCV's files, from ours, or from matrices in the description.

OpenCV's R and T map a point of the left camera into the right one: x_right = R x_left + T. Ours is the other way, the right camera's
frame in that of the left one. Lengths become mm by ``cameras.unit``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from appliance.calibration import file as calibration_file
from appliance.foreign.description import Description, Medium, Ports, as_plain
from appliance.foreign.problem import ForeignError, Table
from appliance.optics.model import HousedCamera, StereoRig
from appliance.optics.pinhole import Lens, distort
from appliance.optics.port import Port
from appliance.optics.rotation import matrix3
from appliance.optics.water import quan_fry_index

Array = NDArray[np.float64]

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
NO_PORT = Port((0.0, 0.0, 1.0), 0.0, 0.0, 1.0)
MOST_FIT_PX = 0.1
"""Largest error in px with which a lens model of more than five values is replaced by one of five."""
GRID = 25
NAMES: Mapping[str, tuple[str, ...]] = {
    "left_matrix": ("m1", "k1", "kl", "ml", "cameramatrix1", "cameramatrixl", "cameramatrixleft", "leftcameramatrix", "intrinsic1",
                    "intrinsicleft", "leftintrinsic", "leftk", "kleft", "camk", "camerak", "cammatrix", "caml", "mtx1", "mtxl", "cameraint"),
    "right_matrix": ("m2", "k2", "kr", "mr", "cameramatrix2", "cameramatrixr", "cameramatrixright", "rightcameramatrix", "intrinsic2",
                     "intrinsicright", "rightintrinsic", "rightk", "kright", "projk", "projectork", "projmatrix", "camr", "mtx2", "mtxr",
                     "projint"),
    "left_distortion": ("d1", "dl", "distcoeffs1", "distcoeffsl", "distcoeffsleft", "leftdistcoeffs", "distortion1", "distortionleft",
                        "leftdistortion", "leftd", "dleft", "distortioncoefficients1", "leftdistortioncoefficients", "camkc", "camerad",
                        "dist1", "distl", "distcoeff1", "distcoeffs", "camd", "camdist"),
    "right_distortion": ("d2", "dr", "distcoeffs2", "distcoeffsr", "distcoeffsright", "rightdistcoeffs", "distortion2", "distortionright",
                         "rightdistortion", "rightd", "dright", "distortioncoefficients2", "rightdistortioncoefficients", "projkc",
                         "projectord", "dist2", "distr", "distcoeff2", "projd", "projdist"),
    "rotation": ("r", "rotation", "rotationmatrix", "rlr", "stereor", "rstereo", "r12"),
    "translation": ("t", "translation", "translationvector", "tlr", "stereot", "tstereo", "t12", "tvec"),
}  # fmt: skip
"""Names under which programs write the same thing, without what is neither letter nor digit."""
ONE_CAMERA = {"matrix": ("cameramatrix", "k", "m", "intrinsic", "intrinsicmatrix", "mtx"), "distortion": (
    "distortioncoefficients", "distcoeffs", "d", "distortion", "dist", "distcoeff")}  # fmt: skip
"""The same in a file of one camera alone."""


@dataclass(frozen=True, slots=True)
class ForeignRig:
    """The cameras, and the index of what is between them and the object."""

    rig: StereoRig
    index: float
    in_air: bool
    calibration: calibration_file.Calibration | None = None
    """The calibration file it is from, where it is one of ours."""


def read_rig(description: Description, sizes_px: Mapping[str, tuple[int, int]]) -> ForeignRig:
    """Return the rig of a description; ``sizes_px`` are (width, height) by side. Raises ForeignError."""
    table = description.cameras
    if "calibration" in table.content:
        table.only("calibration")
        return _our_own(description, table, sizes_px)
    table.only("files", "names", "unit", "left", "right", "rotation", "translation")
    unit_mm = UNITS_MM[table.choice("unit", tuple(UNITS_MM), "mm")]
    found = _from_files(description, table) if "files" in table.content else _from_tables(table)
    index, in_air = index_of(description.medium)
    matrices = {side: _matrix(found, f"{side}_matrix", 3, 3) for side in ("left", "right")}
    R, T = _matrix(found, "rotation", 3, 3), unit_mm * np.ravel(_any(found, "translation", 3))
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0.0:
        raise ForeignError(f"cameras: rotation {R.round(4).tolist()} is no rotation; name the right matrix")
    u, _, vt = np.linalg.svd(R)
    R = u @ vt  # Written with few digits, it is not quite a rotation.
    if float(np.linalg.norm(T)) < 1e-6:
        raise ForeignError("cameras: translation is zero; name the vector between both cameras")
    cameras = []
    for side, rotation, t_mm in (("left", np.eye(3), np.zeros(3)), ("right", R.T, -R.T @ T)):
        width_px, height_px = sizes_px[side]
        lens = lens_of(matrices[side], np.ravel(_any(found, f"{side}_distortion", None)), (width_px, height_px), side)
        port, straight = _port(description.ports, side, in_air)
        cameras.append(
            HousedCamera(width_px, height_px, lens, port, matrix3(rotation), _three(t_mm), lens_in_water=straight)
        )
    return ForeignRig(StereoRig(cameras[0], cameras[1]), index, in_air)


def index_of(medium: Medium) -> tuple[float, bool]:
    """Return the index relative to air, and whether it is air. Raises ForeignError."""
    if medium.index is not None:
        return medium.index, False
    if medium.temperature_c is None:
        return 1.0, True
    return quan_fry_index(medium.temperature_c, medium.salinity_psu, medium.wavelength_nm), False


def inverted(rig: StereoRig) -> StereoRig:
    """Return the rig whose R and T were written the other way round."""
    R, t = np.asarray(rig.right.rotation), np.asarray(rig.right.translation_mm)
    return StereoRig(rig.left, replace(rig.right, rotation=matrix3(R.T), translation_mm=_three(-R.T @ t)))


def lens_of(matrix: Array, distortion: Array, size_px: tuple[int, int], side: str) -> Lens:
    """Return the lens with OpenCV's camera matrix and 0, 4, 5, 8, 12 or 14 distortion values. Raises ForeignError."""
    f_px, c_px = (float(matrix[0, 0]), float(matrix[1, 1])), (float(matrix[0, 2]), float(matrix[1, 2]))
    if abs(matrix[0, 1]) > 1e-3 * f_px[0] or min(f_px) <= 1.0:
        raise ForeignError(
            f"cameras: {side} matrix {matrix.round(3).tolist()} has no two focal lengths, or a skew; name another one"
        )
    width_px, height_px = size_px
    if not (-0.5 * width_px < c_px[0] < 1.5 * width_px and -0.5 * height_px < c_px[1] < 1.5 * height_px):
        raise ForeignError(
            f"cameras: the {side} principal point {c_px[0]:.0f}, {c_px[1]:.0f} lies far outside of images of {width_px} x {height_px} px; "
            "the calibration is of other images, or left and right are exchanged"
        )
    if distortion.size not in (0, 4, 5, 8, 12, 14):
        raise ForeignError(
            f"cameras: {side} distortion has {distortion.size} values; allowed are 4, 5, 8, 12, 14; correct it"
        )
    values = np.zeros(5)
    values[: min(5, distortion.size)] = distortion[:5]
    lens = Lens(f_px, c_px, _five(values))
    if distortion.size > 5 and np.any(distortion[5:] != 0.0):
        lens = _fitted(lens, matrix, distortion, size_px, side)
    try:
        lens.to_directions(
            np.array([[0.0, 0.0], [width_px - 1.0, 0.0], [0.0, height_px - 1.0], [width_px - 1.0, height_px - 1.0]])
        )
    except ValueError as error:
        raise ForeignError(f"cameras: {side} {error}") from error
    return lens


def _fitted(lens: Lens, matrix: Array, distortion: Array, size_px: tuple[int, int], side: str) -> Lens:
    """Return the lens of five values that is nearest to OpenCV's longer model all over the image."""
    u, v = np.meshgrid(*(np.linspace(0.0, size - 1.0, GRID) for size in size_px))
    uv = np.stack([u, v], -1).reshape(-1, 1, 2)
    xy = np.asarray(cv2.undistortPoints(uv, matrix, distortion), np.float64).reshape(-1, 2)
    wanted = (uv.reshape(-1, 2) - np.asarray(lens.c_px)) / np.asarray(lens.f_px)
    fit = least_squares(lambda values: ((distort(xy, _five(values)) - wanted) * lens.f_px[0]).ravel(), np.zeros(5))
    worst_px = float(np.abs(fit.fun).max())
    if worst_px > MOST_FIT_PX:
        raise ForeignError(
            f"cameras: {side} distortion of {distortion.size} values differs from the nearest one of five by {worst_px:.2f} px; allowed "
            f"are {MOST_FIT_PX:g} px; calibrate with k1, k2, p1, p2, k3"
        )
    return replace(lens, distortion=_five(fit.x))


def _our_own(description: Description, table: Table, sizes_px: Mapping[str, tuple[int, int]]) -> ForeignRig:
    path = description.folder / table.text("calibration")
    try:
        calibration = calibration_file.load(path)
    except calibration_file.CalibrationError as error:
        raise ForeignError(str(error)) from error
    if description.ports is not None:
        raise ForeignError(f"[ports] is there, and {path.name} has its own; take [ports] out")
    for side, camera in (("left", calibration.rig.left), ("right", calibration.rig.right)):
        if (camera.width_px, camera.height_px) != sizes_px[side]:
            raise ForeignError(
                f"{path}: its {side} camera has {camera.width_px} x {camera.height_px} px, and the images {sizes_px[side][0]} x "
                f"{sizes_px[side][1]} px; give the calibration of these images"
            )
    index, in_air = index_of(description.medium)
    if in_air:
        # Made in water unless somebody says so: our own files know theirs.
        index, in_air = calibration.water.index, False
    return ForeignRig(calibration.rig, index, in_air, calibration)


def _port(ports: Ports | None, side: str, in_air: bool) -> tuple[Port, bool]:
    """Return the port, and whether rays go straight from the projection centre."""
    if ports is None:
        # In water without a port, the camera was calibrated in water as a pinhole.
        return NO_PORT, True
    if in_air and ports.thickness_mm == 0.0:
        return NO_PORT, True
    normal = ports.normals[0 if side == "left" else 1]
    return Port(normal, ports.distance_mm, ports.thickness_mm, ports.glass_index), False


# ------------------------------------------------------------------------------------------ where the numbers are


def _from_tables(table: Table) -> dict[str, Any]:
    found: dict[str, Any] = {key: table.content[key] for key in ("rotation", "translation") if key in table.content}
    for side in ("left", "right"):
        camera = table.table(side)
        if camera is None:
            raise ForeignError(
                f"[cameras.{side}] is missing: give cameras.files (OpenCV), cameras.calibration (ours), or its matrix and distortion"
            )
        camera.only("matrix", "distortion")
        found[f"{side}_matrix"] = camera.content.get("matrix")
        found[f"{side}_distortion"] = camera.content.get("distortion", [])
    return found


def _from_files(description: Description, table: Table) -> dict[str, Any]:
    value = table.content["files"]
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise table.wrong("files", "the name of a file, or a list of names", "correct it")
    aliases = table.table("names") or Table("cameras.names.", {})
    aliases.only(*NAMES)
    found: dict[str, Any] = {}
    seen: dict[str, list[str]] = {}
    for name in names:
        path = description.folder / name
        values = numbers_in(path)
        seen[name] = list(values)
        plain = {re.sub(r"[^a-z0-9]", "", key.lower()): key for key in values}
        for wanted, spelled in NAMES.items():
            if wanted in aliases.content:
                if aliases.text(wanted) in values:
                    found[wanted] = values[aliases.text(wanted)]
                continue
            hit = next((plain[one] for one in spelled if one in plain), None)
            if hit is not None:
                found.setdefault(wanted, values[hit])
        _one_camera(path, values, plain, found)
    missing = [name for name in NAMES if name not in found and not name.endswith("distortion")]
    if missing:
        there = "; ".join(f"{name}: {', '.join(keys[:20]) or 'no matrices'}" for name, keys in seen.items())
        raise ForeignError(
            f"cameras.files have no {', '.join(missing)} under a name that is known ({there}); say which is which under [cameras.names], "
            f'for example {missing[0]} = "NAME"'
        )
    for side in ("left", "right"):
        found.setdefault(f"{side}_distortion", [])
    return found


def _one_camera(path: Path, values: Mapping[str, Any], plain: Mapping[str, str], found: dict[str, Any]) -> None:
    """Add what a file of one camera says; its name says which camera it is, or the order of the files does."""
    for kind, spelled in ONE_CAMERA.items():
        hit = next((plain[one] for one in spelled if one in plain), None)
        if hit is None or any(values[hit] is one for one in found.values()):
            continue
        stem = path.stem.lower()
        sides = [side for side, words in (("left", ("left", "_l", "cam0")), ("right", ("right", "_r", "cam1", "proj")))
                 if any(word in stem for word in words)]  # fmt: skip
        order = sides or [side for side in ("left", "right") if f"{side}_{kind}" not in found]
        if order:
            found.setdefault(f"{order[0]}_{kind}", values[hit])


def numbers_in(path: Path) -> dict[str, Any]:
    """Return the matrices and vectors of a file by name: OpenCV's YAML, XML or JSON, or NumPy's .npz. Raises ForeignError."""
    if not path.is_file():
        raise ForeignError(f"cameras.files: there is no file {path}; correct the name")
    if path.suffix.lower() == ".npz":
        try:
            with np.load(path, allow_pickle=False) as content:
                return {
                    name: np.asarray(content[name], np.float64)
                    for name in content.files
                    if content[name].dtype.kind in "fiu"
                }
        except (OSError, ValueError, TypeError) as error:
            raise ForeignError(f"{path}: not readable as .npz ({error}); give OpenCV's YAML") from error
    try:
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
        opened = storage.isOpened()
    except (cv2.error, SystemError) as error:
        raise ForeignError(
            f"{path}: not readable as OpenCV's YAML, XML or JSON ({str(error).strip()[-120:]}); correct it"
        ) from error
    if not opened:
        raise ForeignError(
            f"{path}: not readable as OpenCV's YAML, XML or JSON; YAML must begin with %YAML:1.0; or give the matrices in the description"
        )
    found: dict[str, Any] = {}
    try:
        _collect(storage.root(), found, "")
    finally:
        storage.release()
    return found


def _collect(node: Any, found: dict[str, Any], before: str) -> None:
    for key in node.keys():  # noqa: SIM118 (no dictionary)
        child = node.getNode(key)
        name = f"{before}{key}"
        if child.isMap():
            try:
                matrix = child.mat()
            except cv2.error:
                matrix = None
            if matrix is not None:
                found[name] = np.asarray(matrix, np.float64)
            else:
                _collect(child, found, f"{name}.")
        elif (
            child.isSeq()
            and child.size()
            and all(child.at(k).isReal() or child.at(k).isInt() for k in range(child.size()))
        ):
            found[name] = np.array([child.at(k).real() for k in range(child.size())])


def _any(found: Mapping[str, Any], name: str, size: int | None) -> Array:
    """Return numbers of any shape. Raises ForeignError for something else, or another number of them than ``size``."""
    key = name.replace("_", ".") if name.startswith(("left", "right")) else name
    try:
        values = np.asarray(as_plain(found.get(name)), np.float64)
    except (TypeError, ValueError):
        values = np.array(np.nan)
    if not np.isfinite(values).all() or (size is not None and values.size != size):
        raise ForeignError(
            f"cameras.{key} is {found.get(name)!r:.80}; allowed: {size or 'a list of'} numbers; correct it"
        )
    return values


def _matrix(found: Mapping[str, Any], name: str, rows: int, columns: int) -> Array:
    values = _any(found, name, None)
    if name == "rotation" and values.size == 3:
        return np.asarray(cv2.Rodrigues(values.reshape(3, 1))[0], np.float64)
    return _any(found, name, rows * columns).reshape(rows, columns)


def _three(values: Array) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def _five(values: Array) -> tuple[float, float, float, float, float]:
    k1, k2, p1, p2, k3 = (float(value) for value in values)
    return k1, k2, p1, p2, k3
