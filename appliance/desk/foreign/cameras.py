"""Cameras of a foreign rig: from OpenCV's files, our calibrations, or matrices in the description.

OpenCV's R and T map a point of the left camera into the right one: x_right = R x_left + T. Ours is the inverse, the
right camera's pose in the left camera frame. Lengths become mm by ``cameras.unit``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.camera_dialects import KINDS, CameraNumbers, facts_of, interpret_numbers, rotation_of
from appliance.desk.foreign.camera_files import camera_numbers, flatten_names, select_numbers, without_scale
from appliance.desk.foreign.description import Description
from appliance.desk.foreign.problem import ForeignError, Table
from appliance.measure import (
    SIDES,
    Calibration,
    CalibrationError,
    HousedCamera,
    Lens,
    Port,
    StereoRig,
    matrix3,
)
from appliance.store import load_calibration

Array = NDArray[np.float64]

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": 25.4}
NO_PORT = Port((0.0, 0.0, 1.0), 0.0, 0.0, 1.0)
LEAST_BASELINE_MM, MOST_BASELINE_MM = 1.0, 20_000.0
"""Limits of the baseline; one beyond them is in another unit."""
USUAL_MM = (10.0, 3000.0)
"""Limits of the baseline in a unit that is proposed."""
NOTABLE_OFFSET = 0.3
"""Distance of a principal point from the middle, in sizes of the image, above which a note is made."""
MAX_OFFSET = 2.5
"""Largest distance of a principal point beside its image, in sizes of it: projectors shift theirs by half a picture,
and a cropped image may lie where it likes."""


@dataclass(frozen=True, slots=True)
class ForeignRig:
    """The cameras, and the refractive index between them and the object."""

    rig: StereoRig
    index: float
    calibration: Calibration | None = None
    """Our calibration, if the cameras are from one."""
    stated_px: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    """Width and height by side that camera files state; of a camera and a projector the projector is ``right``."""
    scale_known: bool = True
    """False: the translation has length 1, as calibrations without scale have; then lengths are in units of it."""
    notes: tuple[str, ...] = ()
    """Oddities of the cameras' numbers that are worth a look, a line each."""

    @property
    def in_air(self) -> bool:
        return self.index == 1.0


def read_rig(description: Description, sizes_px: Mapping[str, tuple[int, int]]) -> ForeignRig:
    """Return the rig of a description; ``sizes_px`` are (width, height) by side. Raises ForeignError."""
    ours = _own_calibration(description, sizes_px)
    if ours is not None:
        return ours
    table, of_projector = description.cameras, "right" not in description.files
    table.only("files", "names", "unit", *SIDES, "rotation", "translation")
    unit = table.choice("unit", tuple(UNITS_MM), "mm")
    numbers = (
        camera_numbers(description.folder, table, of_projector)
        if "files" in table.content
        else _numbers_in_description(table)
    )
    notes = list(numbers.notes)
    for side, stated in numbers.stated_px.items():
        # Some programs write the height before the width.
        actual_px = sizes_px.get(side, description.projector_px)
        stated = stated[::-1] if stated[::-1] == actual_px else stated
        where = f"cameras.files: {numbers.sizes[side].where}"
        if side in sizes_px:
            _check_size(where, side, stated, actual_px, of_projector)
        elif stated != actual_px:
            notes.append(
                f"{where} says {stated[0]} x {stated[1]} px, and [projector] {actual_px[0]} x {actual_px[1]} px"
            )
    R, T = rotation_of(numbers.numbers["rotation"]), numbers.numbers["translation"]
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-3 or np.linalg.det(R) < 0.0:
        raise ForeignError(f"cameras: rotation {R.round(4).tolist()} is no rotation; give the right matrix")
    u, _, vt = np.linalg.svd(R)
    R = u @ vt  # Written with few digits, it is not quite a rotation.
    length = float(np.linalg.norm(T))
    scale_known = unit != "mm" or not without_scale(length)
    if scale_known:
        _check_baseline(length, unit)
        T = UNITS_MM[unit] * T
    if without_scale(length):
        notes.append(
            f"cameras.unit: the translation is 1 {unit} long, as calibrations without scale have it"
            if scale_known
            else "cameras.unit: the translation has length 1: a calibration without scale; the unit of length is "
            "the baseline"
        )
    cameras = []
    for side, rotation, translation_mm in (("left", np.eye(3), np.zeros(3)), ("right", R.T, -R.T @ T)):
        size_px = sizes_px[side]
        lens = lens_of(
            numbers.numbers[f"{side}_matrix"].reshape(3, 3), numbers.numbers[f"{side}_distortion"], size_px, side
        )
        notes += [
            f"cameras.{side}.matrix: the principal point is at {100 * c / size:.0f} % of the {extent}: the lens is "
            "shifted, or the calibration is for other images"
            for c, size, extent in zip(lens.c_px, size_px, ("width", "height"), strict=True)
            if abs(c / size - 0.5) > NOTABLE_OFFSET
        ]
        x, y, z = translation_mm.tolist()
        cameras.append(HousedCamera(*size_px, lens, NO_PORT, matrix3(rotation), (x, y, z)))
    stated_px = {side: sizes_px[side] for side in numbers.sizes if side in sizes_px}
    rig = _behind_ports(description, StereoRig(cameras[0], cameras[1]))
    return replace(rig, stated_px=stated_px, scale_known=scale_known, notes=tuple(notes))


def _numbers_in_description(table: Table) -> CameraNumbers:
    """Return the camera numbers in the description itself. Raises ForeignError."""
    for side in SIDES:
        camera = table.table(side)
        if camera is None:
            raise ForeignError(
                f"[cameras.{side}] is missing: give cameras.files (OpenCV), cameras.calibration (ours), or its matrix "
                "and distortion"
            )
        camera.only("matrix", "distortion")
    tables = {key: table.content[key] for key in (*SIDES, "rotation", "translation") if key in table.content}
    content = {name: value for name, value in flatten_names(tables) if value != []}
    files = {"[cameras]": select_numbers(content)}
    known_names = {fact.name for fact in facts_of(files)}
    for name, value in content.items():
        if name not in known_names:
            counts = " or ".join(str(count) for kind, (counts, _) in KINDS.items() if kind in name for count in counts)
            raise ForeignError(f"cameras.{name} is {value!r:.80}; allowed: {counts} numbers; correct it")
    return interpret_numbers(files, Table("cameras.names.", {}), of_projector=False)


def _check_size(where: str, side: str, stated: tuple[int, int], actual: tuple[int, int], of_projector: bool) -> None:
    """Raise ForeignError if images have another size than their calibration states."""
    subject, cause, remedy = f"the {side} images have", "another calibration", "give the calibration of these images"
    if of_projector and side == "right":
        subject, cause, remedy = (
            "[projector] says",
            "another projector",
            "correct its size, or give the file of this one",
        )
    elif abs(stated[0] * actual[1] - stated[1] * actual[0]) <= max(actual):
        times = stated[0] / actual[0]
        cause = f"a calibration of images of {({0.5: 'half the', 2.0: 'twice the'}).get(times, f'{times:.3g} times their')} size"
    if stated != actual:
        raise ForeignError(
            f"{where} says {stated[0]} x {stated[1]} px, and {subject} {actual[0]} x {actual[1]} px: {cause}; {remedy}"
        )


def _check_baseline(length: float, unit: str) -> None:
    if length * UNITS_MM[unit] < 1e-6:
        raise ForeignError("cameras: translation is zero; give the vector between both cameras")
    if not LEAST_BASELINE_MM <= length * UNITS_MM[unit] <= MOST_BASELINE_MM:
        fits = [f'"{name}"' for name, mm in UNITS_MM.items() if USUAL_MM[0] < length * mm < USUAL_MM[1]]
        raise ForeignError(
            f"cameras: the baseline is {length:.3g} {unit}; allowed: {LEAST_BASELINE_MM:g} mm to "
            f"{MOST_BASELINE_MM / 1000:g} m; give "
            f"the unit of the translation: cameras.unit = {' or '.join(fits) or 'mm, cm, m or inch'}"
        )


def lens_of(matrix: Array, distortion: Array, size_px: tuple[int, int], side: str) -> Lens:
    """Return the lens with OpenCV's camera matrix and 0, 4, 5, 8, 12 or 14 distortion values.

    Raises ForeignError.
    """
    f_px, c_px = (float(matrix[0, 0]), float(matrix[1, 1])), (float(matrix[0, 2]), float(matrix[1, 2]))
    if abs(matrix[0, 1]) > 1e-3 * f_px[0] or min(f_px) <= 1.0:
        raise ForeignError(
            f"cameras: {side} matrix {matrix.round(3).tolist()} has no two focal lengths, or a skew; give another one"
        )
    width_px, height_px = size_px
    if not all(-MAX_OFFSET * size < c < (1.0 + MAX_OFFSET) * size for c, size in zip(c_px, size_px, strict=True)):
        raise ForeignError(
            f"cameras: the {side} principal point {c_px[0]:.0f}, {c_px[1]:.0f} lies far outside images of "
            f"{width_px} x {height_px} px; "
            "give the calibration of these images, and check that left and right are not exchanged"
        )
    if distortion.size not in (0, 4, 5, 8, 12, 14) or np.any(distortion[12:] != 0.0):
        raise ForeignError(
            f"cameras: {side} distortion has {distortion.size} values, {distortion.tolist()!r:.200}; allowed are 4, 5, "
            "8, 12, 14, the last two zero "
            "(no tilted sensor); correct it"
        )
    values = np.zeros(12 if np.any(distortion[5:] != 0.0) else 5)
    values[: min(values.size, distortion.size)] = distortion[: values.size]
    return Lens(f_px, c_px, tuple(values.tolist()))


def _own_calibration(description: Description, sizes_px: Mapping[str, tuple[int, int]]) -> ForeignRig | None:
    """Return the cameras of our calibration file, if the table of the cameras names one.

    ``None`` if none is named.
    """
    table = description.cameras
    is_named = "calibration" in table.content
    files = table.content.get("files")
    name = table.text("calibration") if is_named else files[0] if isinstance(files, list) and len(files) == 1 else files
    if not is_named and not str(name).lower().endswith(".json"):
        return None
    path = description.folder / str(name)
    try:
        ours = load_calibration(path)
    except CalibrationError as error:
        if is_named:
            raise ForeignError(str(error)) from error
        return None
    table.only("calibration" if is_named else "files")
    cameras = {"left": ours.rig.left, "right": ours.rig.right}
    stated_px = {side: (camera.width_px, camera.height_px) for side, camera in cameras.items()}
    for side, stated in stated_px.items():
        _check_size(str(path), side, stated, sizes_px[side], "right" not in description.files)
    if not any(
        housed.port.distance_mm
        or housed.port.thickness_mm
        or housed.correction
        or housed.ray_shift
        or housed.lens_in_water
        for housed in cameras.values()
    ):
        # A file of `calibration air --pair` knows neither ports nor water, like OpenCV's files.
        return replace(_behind_ports(description, ours.rig), stated_px=stated_px)
    if description.ports is not None:
        raise ForeignError(f"[ports] is given, but {path.name} has its own ports; leave out [ports]")
    # Our files know their water, unless the description states another one.
    index = ours.water.index if description.water is None else description.index
    return ForeignRig(ours.rig, index, ours, stated_px)


def _behind_ports(description: Description, rig: StereoRig) -> ForeignRig:
    """Return the cameras behind the ports of the description.

    Without ports rays go straight, in water too: there the cameras were calibrated in water.
    """
    ports = description.ports
    if ports is None or (description.water is None and ports[0].thickness_mm == 0.0):
        housed = [replace(camera, port=NO_PORT, lens_in_water=True) for camera in (rig.left, rig.right)]
    else:
        housed = [replace(camera, port=port) for camera, port in zip((rig.left, rig.right), ports, strict=True)]
    return ForeignRig(StereoRig(housed[0], housed[1]), description.index)
