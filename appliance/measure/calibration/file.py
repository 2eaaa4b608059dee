"""The calibration file: versioned, checksummed, readable JSON, one per instrument, with its sources.

The text is JSON with sorted keys; ``sha256`` is that of the compact form of everything else. Lengths are mm, image
coordinates px, angles never appear (rotations are matrices).

``air_covariance``, ``air_field``, ``depth_error_mm2`` and ``camera_serials`` are present if they are known; a camera's
``correction``, ``ray_shift`` and ``lens_in_water`` if its model has them.
"""

from __future__ import annotations

import math
from dataclasses import asdict, astuple, dataclass, field
from typing import Annotated

import numpy as np

from appliance.base import LEFT_OUT, Among, ContentError, SealedFile, Within, digest, one_line
from appliance.measure.calibration.depth_error import DEPTH_ERROR_TERMS as DEPTH_ERRORS
from appliance.measure.calibration.depth_error import Rows
from appliance.measure.calibration.field import AIR_VALUES, AirField
from appliance.measure.light.correction import ImageCorrection, node_count
from appliance.measure.light.model import HousedCamera, StereoRig
from appliance.measure.light.pinhole import Lens
from appliance.measure.light.port import Port
from appliance.measure.light.ray_shift import RayShift
from appliance.measure.light.volume import WorkingVolume
from appliance.measure.light.water import Water

Matrix22 = tuple[tuple[float, ...], ...]
"""(22, 22), symmetric, positive definite."""

IN_AIR = "air"
"""Method of a calibration in air, which is the start of a water calibration and nothing else."""
MAX_INTERVALS = 64


class CalibrationError(Exception):
    """A calibration file cannot be used; the text says which, why and the remedy."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """The instrument as measured. ``hash`` identifies it in every scan made with it."""

    rig_serial: str
    method: str
    """Method that made it: ``design`` (never measured), ``air``, ``bundle``, …"""
    made_at: str
    """ISO 8601 date and time, or ``unknown``."""
    made_from: tuple[str, ...]
    """Ids or descriptions of the scans and values from which it was made."""
    water: Water
    """The water during the calibration; other water only changes the index when rays are derived."""
    rig: StereoRig
    residual_px: float | None = None
    """RMS residual of the adjustment; ``None``: there was no adjustment."""
    air_covariance: Matrix22 | None = None
    """Covariance of the values from air (``RIG_PARAMETERS.air``): the prior of a water calibration."""
    air_field: AirField | None = None
    """Image corrections from air: the prior of a water calibration with an image correction. ``None``: unknown."""
    depth_error_mm2: Rows | None = None
    """Covariance (n, n) of the shared depth error (``calibration.depth_error``) after the water calibration; ``None``:
    unknown."""
    camera_serials: tuple[str, str] | None = None
    """Serial numbers of the left and the right camera; ``None``: unknown, as in a design."""

    __repr__ = one_line

    @property
    def hash(self) -> str:
        """SHA-256 of the content, hexadecimal."""
        return digest(CALIBRATION.content(_Content.of(self)))


def encode_calibration(calibration: Calibration) -> bytes:
    """Return the file's bytes."""
    return CALIBRATION.encode(_Content.of(calibration))


def decode_calibration(data: bytes, name: str = "calibration") -> Calibration:
    """Parse and check a file's bytes. Raises CalibrationError with ``name``, the key, value and remedy."""
    try:
        return CALIBRATION.decode(data, name).calibration()
    except ContentError as error:
        raise CalibrationError(str(error)) from error
    except ValueError as error:
        raise CalibrationError(f"{name}: {error}; {CALIBRATION.remedy}") from error


# ------------------------------------------------------------------------------------------ as it is written

_Pixels = Annotated[float, Within(16, 16384)]
_Intervals = tuple[Annotated[float, Within(1, MAX_INTERVALS)], Annotated[float, Within(1, MAX_INTERVALS)]]
_Hundred = Annotated[float, Within(-100.0, 100.0)]
_Focal = Annotated[float, Within(1.0, 1e6)]
_Centre = Annotated[float, Within(-1e5, 1e5)]
_Place = Annotated[float, Within(-10_000.0, 10_000.0)]
_Unit = Annotated[float, Within(-1.0, 1.0)]
_Rotated = Annotated[float, Within(-1.001, 1.001)]
_Row = tuple[_Rotated, _Rotated, _Rotated]
_Distance = Annotated[float, Within(1.0, 10_000.0)]
_Covariance = tuple[tuple[Annotated[float, Within(-1e12, 1e12)], ...], ...]


@dataclass(frozen=True, slots=True)
class _WaterEntry:
    temperature_c: Annotated[float, Within(-2.0, 40.0)]
    salinity_psu: Annotated[float, Within(0.0, 45.0)]
    wavelength_nm: Annotated[float, Within(380.0, 750.0)]


@dataclass(frozen=True, slots=True)
class _VolumeEntry:
    nearest_mm: _Distance
    working_mm: _Distance
    farthest_mm: _Distance


@dataclass(frozen=True, slots=True)
class _PortEntry:
    normal: tuple[_Unit, _Unit, _Unit]
    distance_mm: Annotated[float, Within(0.0, 1000.0)]
    thickness_mm: Annotated[float, Within(0.0, 100.0)]
    glass_index: Annotated[float, Within(1.0, 3.0)]


@dataclass(frozen=True, slots=True)
class _CorrectionEntry:
    intervals: _Intervals
    coefficients_px: tuple[_Hundred, ...]


@dataclass(frozen=True, slots=True)
class _ShiftEntry:
    intervals: _Intervals
    coefficients_mm: tuple[_Hundred, ...]


@dataclass(frozen=True, slots=True)
class _CameraEntry:
    width_px: _Pixels
    height_px: _Pixels
    f_px: tuple[_Focal, _Focal]
    c_px: tuple[_Centre, _Centre]
    distortion: tuple[_Hundred, ...]
    rotation: tuple[_Row, _Row, _Row]
    translation_mm: tuple[_Place, _Place, _Place]
    port: _PortEntry
    correction: _CorrectionEntry | None = field(default=None, metadata=LEFT_OUT)
    ray_shift: _ShiftEntry | None = field(default=None, metadata=LEFT_OUT)
    lens_in_water: Annotated[bool, Among((True, False))] = field(default=False, metadata=LEFT_OUT)

    @classmethod
    def of(cls, camera: HousedCamera) -> _CameraEntry:
        """Return the entry of a camera."""
        lens, port, correction, shift = camera.lens, camera.port, camera.correction, camera.ray_shift
        return cls(
            camera.width_px,
            camera.height_px,
            lens.f_px,
            lens.c_px,
            lens.distortion,
            camera.rotation,
            camera.translation_mm,
            _PortEntry(port.normal, port.distance_mm, port.thickness_mm, port.glass_index),
            None if correction is None else _CorrectionEntry(correction.intervals, correction.coefficients_px),
            None if shift is None else _ShiftEntry(shift.intervals, shift.coefficients_mm),
            camera.lens_in_water,
        )

    def camera(self) -> HousedCamera:
        """Return the camera. Raises ValueError for impossible values."""
        R, normal = np.array(self.rotation), self.port.normal
        if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0.0:
            raise ValueError(f"rotation is {self.rotation!r:.80}; allowed: a rotation matrix")
        if abs(math.hypot(*normal) - 1.0) > 1e-6 or normal[2] < 0.5:
            raise ValueError(f"port.normal is {normal!r:.80}; allowed: a unit vector towards the water")
        size_px = int(self.width_px), int(self.height_px)
        correction, shift = self.correction, self.ray_shift
        if len(self.distortion) != 5:
            raise ValueError(f"distortion is {self.distortion!r:.80}; allowed: a list of 5")
        return HousedCamera(
            *size_px,
            Lens(self.f_px, self.c_px, self.distortion),
            Port(*astuple(self.port)),
            self.rotation,
            self.translation_mm,
            None
            if correction is None
            else ImageCorrection(*size_px, _whole(correction.intervals), correction.coefficients_px),
            None if shift is None else RayShift(*size_px, _whole(shift.intervals), shift.coefficients_mm),
            self.lens_in_water,
        )


@dataclass(frozen=True, slots=True)
class _CamerasEntry:
    left: _CameraEntry
    right: _CameraEntry

    def cameras(self) -> tuple[HousedCamera, HousedCamera]:
        """Return both cameras. Raises ValueError with the name of an impossible one."""
        cameras = []
        for side, written in (("left", self.left), ("right", self.right)):
            try:
                cameras.append(written.camera())
            except ValueError as error:
                raise ValueError(f"cameras.{side}: {error}") from error
        return cameras[0], cameras[1]


@dataclass(frozen=True, slots=True)
class _SerialsEntry:
    left: str
    right: str


@dataclass(frozen=True, slots=True)
class _FieldEntry:
    intervals: _Intervals
    mean: tuple[Annotated[float, Within(-1e3, 1e3)], ...]
    root: str

    def field(self) -> AirField:
        """Return the image corrections from air. Raises ValueError for a wrong length."""
        intervals = _whole(self.intervals)
        size = AIR_VALUES + AirField.EYES * node_count(intervals)
        if len(self.mean) != size:
            raise ValueError(f"air_field.mean has {len(self.mean)} numbers; allowed: {size}")
        try:
            return AirField.from_text(intervals, self.mean, self.root)
        except ValueError as error:
            raise ValueError(
                f"air_field.root is {self.root!r:.80}; allowed: the factor of a covariance, base64 ({error})"
            ) from error


@dataclass(frozen=True, slots=True)
class _Content:
    """Content of the file."""

    rig_serial: str
    method: str
    made_at: str
    made_from: tuple[str, ...]
    water: _WaterEntry
    cameras: _CamerasEntry
    volume: _VolumeEntry
    residual_px: Annotated[float, Within(0.0, 1e6)] | None = None
    air_covariance: _Covariance | None = field(default=None, metadata=LEFT_OUT)
    air_field: _FieldEntry | None = field(default=None, metadata=LEFT_OUT)
    depth_error_mm2: _Covariance | None = field(default=None, metadata=LEFT_OUT)
    camera_serials: _SerialsEntry | None = field(default=None, metadata=LEFT_OUT)

    @classmethod
    def of(cls, calibration: Calibration) -> _Content:
        """Return the content of a calibration's file."""
        rig, of_air, serials = calibration.rig, calibration.air_field, calibration.camera_serials
        return cls(
            calibration.rig_serial,
            calibration.method,
            calibration.made_at,
            calibration.made_from,
            _WaterEntry(**asdict(calibration.water)),
            _CamerasEntry(_CameraEntry.of(rig.left), _CameraEntry.of(rig.right)),
            _VolumeEntry(**asdict(rig.volume)),
            calibration.residual_px,
            calibration.air_covariance,
            None if of_air is None else _FieldEntry(of_air.intervals, of_air.mean, of_air.text),
            calibration.depth_error_mm2,
            None if serials is None else _SerialsEntry(*serials),
        )

    def calibration(self) -> Calibration:
        """Return the calibration. Raises ValueError for impossible values."""
        serials = self.camera_serials
        return Calibration(
            self.rig_serial,
            self.method,
            self.made_at,
            self.made_from,
            Water(**asdict(self.water)),
            StereoRig(*self.cameras.cameras(), WorkingVolume(**asdict(self.volume))),
            self.residual_px,
            _covariance("air_covariance", self.air_covariance, AIR_VALUES),
            None if self.air_field is None else self.air_field.field(),
            _covariance("depth_error_mm2", self.depth_error_mm2, DEPTH_ERRORS),
            None if serials is None else (serials.left, serials.right),
        )


def _whole(intervals: tuple[float, float]) -> tuple[int, int]:
    return int(intervals[0]), int(intervals[1])


def _covariance(key: str, rows: _Covariance | None, size: int) -> _Covariance | None:
    """Return a covariance (size, size). Raises ValueError if it is not a valid one."""
    if rows is None:
        return None
    if [len(row) for row in rows] != [size] * size:
        raise ValueError(f"{key} is {rows!r:.80}; allowed: {size} lists of {size}")
    C = np.array(rows)
    sd = np.sqrt(np.maximum(np.diag(C), 1e-300))  # units differ by many powers of ten
    if not np.array_equal(C, C.T) or np.linalg.eigvalsh(C / np.outer(sd, sd))[0] <= 0.0:
        raise ValueError(f"{key} is {rows!r:.80}; allowed: a symmetric, positive definite matrix")
    return rows


CALIBRATION = SealedFile(
    _Content,
    schema=1,
    max_bytes=16 * 1024 * 1024,
    what="calibration",
    remedy="restore the previous calibration or calibrate again",
)
