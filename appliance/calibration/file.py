"""Owns the calibration file: versioned, checksummed, readable JSON, one per instrument, with what it was made from.

The text is JSON with sorted keys; ``sha256`` is that of the compact form of everything else. Lengths are mm, image
coordinates px, angles never appear (rotations are matrices).

``air_covariance``, ``air_field``, ``depth_error_mm2`` and ``camera_serials`` are there where they are known; a camera's ``correction``,
``ray_shift`` and ``lens_in_water`` where its model has them.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np

from appliance.bounded_file import read_bounded
from appliance.calibration.depth_error import COUNT as DEPTH_ERRORS
from appliance.calibration.depth_error import Rows
from appliance.calibration.field import AIR_VALUES, EYES, AirField
from appliance.checksummed_file import ChecksumError, checked_content, digest, with_checksum
from appliance.one_line import one_line
from appliance.optics.correction import ImageCorrection, node_count
from appliance.optics.model import HousedCamera, Matrix3, StereoRig
from appliance.optics.pinhole import Lens
from appliance.optics.port import Port
from appliance.optics.ray_shift import RayShift
from appliance.optics.volume import WorkingVolume
from appliance.optics.water import Water

Matrix22 = tuple[tuple[float, ...], ...]
"""(22, 22), symmetric, positive definite."""

SCHEMA = 1
IN_AIR = "air"
"""Method of a calibration in air, which only calibrating in water begins with."""
MAX_INTERVALS = 64
MAX_BYTES = 16 * 1024 * 1024


class CalibrationError(Exception):
    """A calibration file cannot be used; the text says which, why and what to do."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """The instrument as measured. ``hash`` identifies it in every scan made with it."""

    rig_serial: str
    method: str
    """Method that made it: ``design`` (never measured), ``air``, ``bundle``, …"""
    made_at: str
    """ISO 8601 date and time, or ``unknown``."""
    made_from: tuple[str, ...]
    """Ids or descriptions of the recordings and values it was made from."""
    water: Water
    """The water during the calibration; other water only changes the index when rays are derived."""
    rig: StereoRig
    residual_px: float | None = None
    """RMS residual of the adjustment, ``None`` where there was none."""
    air_covariance: Matrix22 | None = None
    """Covariance of the values from air (``parameters.NAMES[AIR]``): the prior of an adjustment in water that starts
    here."""
    air_field: AirField | None = None
    """The lenses' fields as boards in air tell of them: with it, the prior of an adjustment with an image correction.
    ``None``: not known."""
    depth_error_mm2: Rows | None = None
    """Covariance (n, n) of the smooth depth error that all its scans share (``calibration.depth_error``), as the adjustment in water left
    it; ``None``: not known."""
    camera_serials: tuple[str, str] | None = None
    """Serial numbers of the left and the right camera; ``None``: not known, as in a drawing."""

    __repr__ = one_line

    @property
    def hash(self) -> str:
        """SHA-256 of the content, hexadecimal."""
        return digest(_content(self))


def encode(calibration: Calibration) -> bytes:
    """Return the file's bytes. Raises CalibrationError for a camera model that is for comparison only."""
    return with_checksum(_content(calibration))


def decode(data: bytes, name: str = "calibration") -> Calibration:
    """Parse and check a file's bytes. Raises CalibrationError naming ``name``, the key, the value and the remedy."""
    remedy = "restore the previous calibration or calibrate again"
    try:
        content = checked_content(data, MAX_BYTES)
    except ChecksumError as error:
        raise CalibrationError(f"{name}: {error}; {remedy}") from error
    schema = content.get("schema")
    if schema != SCHEMA:
        raise CalibrationError(f"{name}: schema {schema!r:.40}; this version reads schema {SCHEMA}; {remedy}")
    reader = _Reader(name, remedy)
    cameras = reader.table(content, "cameras")
    residual = content.get("residual_px")
    water = reader.table(content, "water")
    return Calibration(
        rig_serial=reader.text(content, "rig_serial"),
        method=reader.text(content, "method"),
        made_at=reader.text(content, "made_at"),
        made_from=tuple(str(item) for item in reader.sequence(content, "made_from")),
        water=Water(
            reader.number(water, "temperature_c", -2.0, 40.0),
            reader.number(water, "salinity_psu", 0.0, 45.0),
            reader.number(water, "wavelength_nm", 380.0, 750.0),
        ),
        rig=StereoRig(reader.camera(cameras, "left"), reader.camera(cameras, "right"), reader.volume(content)),
        residual_px=None if residual is None else reader.number(content, "residual_px", 0.0, 1e6),
        air_covariance=reader.covariance(content),
        air_field=reader.air_field(content),
        depth_error_mm2=reader.depth_error(content),
        camera_serials=reader.serials(content),
    )


def load(path: Path | str) -> Calibration:
    """Read a calibration file. Raises CalibrationError also for a missing or unreadable file."""
    try:
        data = read_bounded(Path(path), MAX_BYTES)
    except OSError as error:
        raise CalibrationError(
            f"calibration {path}: cannot be read ({error.strerror}); calibrate, or copy the instrument's file there"
        ) from error
    return decode(data, f"calibration {path}")


def _content(calibration: Calibration) -> dict[str, Any]:
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "rig_serial": calibration.rig_serial,
        "method": calibration.method,
        "made_at": calibration.made_at,
        "made_from": list(calibration.made_from),
        "residual_px": calibration.residual_px,
        "water": {
            "temperature_c": calibration.water.temperature_c,
            "salinity_psu": calibration.water.salinity_psu,
            "wavelength_nm": calibration.water.wavelength_nm,
        },
        "cameras": {"left": _camera(calibration.rig.left), "right": _camera(calibration.rig.right)},
        "volume": asdict(calibration.rig.volume),
    }
    if calibration.air_covariance is not None:
        content["air_covariance"] = [list(row) for row in calibration.air_covariance]
    if calibration.air_field is not None:
        field = calibration.air_field
        content["air_field"] = {"intervals": list(field.intervals), "mean": list(field.mean), "root": field.text}
    if calibration.depth_error_mm2 is not None:
        content["depth_error_mm2"] = [list(row) for row in calibration.depth_error_mm2]
    if calibration.camera_serials is not None:
        content["camera_serials"] = dict(zip(("left", "right"), calibration.camera_serials, strict=True))
    return content


def _camera(camera: HousedCamera) -> dict[str, Any]:
    table: dict[str, Any] = {
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "f_px": list(camera.lens.f_px),
        "c_px": list(camera.lens.c_px),
        "distortion": list(camera.lens.distortion),
        "rotation": [list(row) for row in camera.rotation],
        "translation_mm": list(camera.translation_mm),
        "port": {
            "normal": list(camera.port.normal),
            "distance_mm": camera.port.distance_mm,
            "thickness_mm": camera.port.thickness_mm,
            "glass_index": camera.port.glass_index,
        },
    }
    if camera.correction is not None:
        table["correction"] = {
            "intervals": list(camera.correction.intervals),
            "coefficients_px": list(camera.correction.coefficients_px),
        }
    if camera.ray_shift is not None:
        table["ray_shift"] = {
            "intervals": list(camera.ray_shift.intervals),
            "coefficients_mm": list(camera.ray_shift.coefficients_mm),
        }
    if camera.lens_in_water:
        table["lens_in_water"] = True
    return table


@dataclass(frozen=True, slots=True)
class _Reader:
    """Checked access to the parsed JSON; every complaint names the file, the key, the value and the range."""

    name: str
    remedy: str

    def fail(self, key: str, value: object, allowed: str) -> CalibrationError:
        return CalibrationError(f"{self.name}: {key} is {value!r:.80}; allowed: {allowed}; {self.remedy}")

    def table(self, parent: dict[str, Any], key: str) -> dict[str, Any]:
        value = parent.get(key)
        if not isinstance(value, dict):
            raise self.fail(key, value, "a table")
        return value

    def text(self, parent: dict[str, Any], key: str) -> str:
        value = parent.get(key)
        if not isinstance(value, str):
            raise self.fail(key, value, "a text")
        return value

    def sequence(self, parent: dict[str, Any], key: str, length: int | None = None) -> list[Any]:
        value = parent.get(key)
        if not isinstance(value, list) or (length is not None and len(value) != length):
            raise self.fail(key, value, "a list" if length is None else f"a list of {length}")
        return value

    def number(self, parent: dict[str, Any], key: str, low: float, high: float) -> float:
        return self._number(parent.get(key), key, low, high)

    def _number(self, value: object, key: str, low: float, high: float) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.fail(key, value, f"a number {low:g}..{high:g}")
        if not low <= value <= high:
            raise self.fail(key, value, f"{low:g}..{high:g}")
        return float(value)

    def numbers(self, parent: dict[str, Any], key: str, length: int, low: float, high: float) -> tuple[float, ...]:
        items = self.sequence(parent, key, length)
        return tuple(self._number(item, f"{key}[{i}]", low, high) for i, item in enumerate(items))

    def camera(self, parent: dict[str, Any], side: str) -> HousedCamera:
        table = self.table(parent, side)
        port = self.table(table, "port")
        rows = self.sequence(table, "rotation", 3)
        rotation = tuple(self.numbers({f"{side}.rotation": row}, f"{side}.rotation", 3, -1.001, 1.001) for row in rows)
        R = np.array(rotation)
        if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0.0:
            raise self.fail(f"{side}.rotation", rows, "a rotation matrix")
        normal = self.numbers(port, "normal", 3, -1.0, 1.0)
        if abs(math.hypot(*normal) - 1.0) > 1e-6 or normal[2] < 0.5:
            raise self.fail(f"{side}.port.normal", normal, "a unit vector towards the water")
        distortion = self.numbers(table, "distortion", 5, -100.0, 100.0)
        width_px, height_px = (int(self.number(table, key, 16, 16384)) for key in ("width_px", "height_px"))
        return HousedCamera(
            width_px=width_px,
            height_px=height_px,
            lens=Lens(
                cast(tuple[float, float], self.numbers(table, "f_px", 2, 1.0, 1e6)),
                cast(tuple[float, float], self.numbers(table, "c_px", 2, -1e5, 1e5)),
                cast(tuple[float, float, float, float, float], distortion),
            ),
            port=Port(
                cast(tuple[float, float, float], normal),
                self.number(port, "distance_mm", 0.0, 1000.0),
                self.number(port, "thickness_mm", 0.0, 100.0),
                self.number(port, "glass_index", 1.0, 3.0),
            ),
            rotation=cast(Matrix3, rotation),
            translation_mm=cast(
                tuple[float, float, float], self.numbers(table, "translation_mm", 3, -10000.0, 10000.0)
            ),
            correction=self.correction(table, width_px, height_px),
            ray_shift=self.ray_shift(table, width_px, height_px),
            lens_in_water=self.lens_in_water(table),
        )

    def correction(self, camera: dict[str, Any], width_px: int, height_px: int) -> ImageCorrection | None:
        if "correction" not in camera:
            return None
        return ImageCorrection(width_px, height_px, *self.spline(camera, "correction", "coefficients_px"))

    def ray_shift(self, camera: dict[str, Any], width_px: int, height_px: int) -> RayShift | None:
        if "ray_shift" not in camera:
            return None
        return RayShift(width_px, height_px, *self.spline(camera, "ray_shift", "coefficients_mm"))

    def spline(self, camera: dict[str, Any], key: str, values: str) -> tuple[tuple[int, int], tuple[float, ...]]:
        table = self.table(camera, key)
        across, down = (int(n) for n in self.numbers(table, "intervals", 2, 1, MAX_INTERVALS))
        count = 2 * node_count((across, down))
        return (across, down), self.numbers(table, values, count, -100.0, 100.0)

    def volume(self, content: dict[str, Any]) -> WorkingVolume:
        """Return the measuring volume."""
        table = self.table(content, "volume")
        numbers = [self.number(table, key, 1.0, 10_000.0) for key in ("nearest_mm", "working_mm", "farthest_mm")]
        try:
            return WorkingVolume(*numbers)
        except ValueError as error:
            raise self.fail("volume", table, str(error)) from error

    def covariance(self, content: dict[str, Any]) -> Matrix22 | None:
        """Return the covariance of the calibration in air; ``None``: the file has none."""
        if "air_covariance" not in content:
            return None
        return self._matrix(content, "air_covariance", AIR_VALUES)

    def depth_error(self, content: dict[str, Any]) -> Rows | None:
        """Return the covariance of the shared depth error; ``None``: the file has none."""
        if "depth_error_mm2" not in content:
            return None
        return self._matrix(content, "depth_error_mm2", DEPTH_ERRORS)

    def _matrix(self, content: dict[str, Any], key: str, size: int) -> tuple[tuple[float, ...], ...]:
        """Return a covariance (size, size)."""
        rows = self.sequence(content, key, size)
        matrix = tuple(self.numbers({key: row}, key, size, -1e12, 1e12) for row in rows)
        C = np.array(matrix)
        sd = np.sqrt(np.maximum(np.diag(C), 1e-300))  # units differ by many powers of ten
        if not np.array_equal(C, C.T) or np.linalg.eigvalsh(C / np.outer(sd, sd))[0] <= 0.0:
            raise self.fail(key, rows, "a symmetric, positive definite matrix")
        return matrix

    def air_field(self, content: dict[str, Any]) -> AirField | None:
        """Return the lenses' fields from air; ``None``: the file has none."""
        if "air_field" not in content:
            return None
        table = self.table(content, "air_field")
        across, down = (int(n) for n in self.numbers(table, "intervals", 2, 1, MAX_INTERVALS))
        size = AIR_VALUES + EYES * node_count((across, down))
        mean, root = self.numbers(table, "mean", size, -1e3, 1e3), self.text(table, "root")
        try:
            return AirField.from_text((across, down), mean, root)
        except ValueError as error:
            raise self.fail("air_field.root", root, f"the factor of a covariance, base64 ({error})") from error

    def serials(self, content: dict[str, Any]) -> tuple[str, str] | None:
        if "camera_serials" not in content:
            return None
        table = self.table(content, "camera_serials")
        return self.text(table, "left"), self.text(table, "right")

    def lens_in_water(self, camera: dict[str, Any]) -> bool:
        value = camera.get("lens_in_water", False)
        if not isinstance(value, bool):
            raise self.fail("lens_in_water", value, "true or false")
        return value
