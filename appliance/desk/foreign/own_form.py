"""Foreign sets that have the form of our own scans, and the scan folder of these.

A set has that form if it keeps the promise of ``PatternSequence`` after its images are put into another order. It
becomes a scan folder like any of ours; of any other set the reason is given, and only a cloud can be written.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from appliance import __version__
from appliance.desk.foreign.description import AxisConvention, Description
from appliance.desk.foreign.images import ImageSet
from appliance.desk.foreign.order import Shows
from appliance.desk.foreign.points import ForeignCloud, ForeignScan
from appliance.desk.foreign.problem import ForeignError
from appliance.measure import (
    SIDES,
    STEP_ORDERS,
    Calibration,
    Direction,
    HousedCamera,
    PatternSequence,
    QualityLimits,
    Water,
    build_sequence,
    of_side,
)
from appliance.store import Instrument, Rig, ScanRecord, SequenceInfo, StoredScan, load_rig

_FOUR_DEG = [0, 90, 180, 270]
METHOD = "foreign"
"""Method of a foreign calibration."""
LEAST_WITHIN = 0.5
"""Least share of the points that lie within the instrument's own depths, for a scan folder."""


def own_sequence(description: Description, images: ImageSet) -> PatternSequence | str:
    """Return the sequence of a set that has our form, else the reason why it has not, in words."""
    if "right" not in description.files:
        return "it has no second camera"
    if description.one_direction:
        return f"it has fringes of one direction only, {description.axes[0].name}"
    if images.images.dtype != np.uint8:
        return "its images have 16 bits"
    if not {Shows.BRIGHT, Shows.DARK} <= {role.shows for role in images.shown}:
        return "it has no bright and dark image"
    for axis in description.axes:
        reason = _reason_against(axis)
        if reason is not None:
            return f"{axis.name}: {reason}"
    periods = {axis.period_px for axis in description.axes}
    if len(periods) != 1:
        return "its two directions have different periods"
    try:
        sequence = build_sequence(round(periods.pop()), *description.projector_px, steps=_order(description))
    except ValueError as error:
        return str(error)
    for axis in description.axes:
        needed = _bits(sequence, axis)
        if axis.bits < needed:
            return f"{axis.name}: {axis.bits} images of its code, and {needed} are needed"
    return sequence


def own_frames(sequence: PatternSequence, description: Description, images: ImageSet) -> NDArray[np.uint8]:
    """Return the images (n, h, w) uint8 of one camera in the order of ``sequence``, from ``own_sequence``."""
    frames = [images.image(Shows.BRIGHT), images.image(Shows.DARK)]
    for axis in description.axes:
        bits = range(axis.bits)[::-1] if axis.fine_first else range(axis.bits)
        # Images before the most significant bit that is needed are entirely dark.
        frames += [images.image(Shows.GRAY, axis.name, bit) for bit in bits[axis.bits - _bits(sequence, axis) :]]
        frames += [images.image(Shows.SINE, axis.name, _steps(axis).index(_FOUR_DEG[step])) for step in sequence.steps]
    return np.stack([frame for frame in frames if frame is not None])


def _bits(sequence: PatternSequence, axis: AxisConvention) -> int:
    return len(sequence.axis(Direction(axis.name)).gray)


def _order(description: Description) -> tuple[int, ...]:
    """Return the order of our steps in which they were projected; the rising one for any other order."""
    orders = {tuple(_FOUR_DEG.index(step) for step in _steps(axis)) for axis in description.axes}
    return next((order for order in STEP_ORDERS if orders == {order}), STEP_ORDERS[-1])


def _steps(axis: AxisConvention) -> list[int]:
    """Return the phase that each image adds to ours, in whole degrees 0 to 359."""
    return [round(axis.begins_deg[0] + step) % 360 for step in axis.signed_deg[0]]


def _reason_against(axis: AxisConvention) -> str | None:
    if len(axis.periods_px) != 1:
        return f"it has {len(axis.periods_px)} periods"
    if axis.period_px != round(axis.period_px):
        return f"its period is {axis.period_px:g} px, no whole number"
    if sorted(_steps(axis)) != _FOUR_DEG:
        return f"its steps {', '.join(f'{step}°' for step in _steps(axis))} are not the four of 0°, 90°, 180°, 270°"
    if axis.carriers:
        return "its fringes have a carrier"
    if not axis.bits:
        return "it has no Gray code"
    if axis.plain_binary or axis.inverted:
        return "its code is plain binary, or inverted"
    if axis.stripe_px != 0.5 * axis.period_px or axis.code_offset_px != 0.0:
        return "its code does not count half periods from the edge of the pattern"
    return None


def require_sequence(path: Path, out: Path, description: Description, images: ImageSet) -> PatternSequence:
    """Return the sequence of a set that has our form. Raises ForeignError for any other set."""
    sequence = own_sequence(description, images)
    if isinstance(sequence, str):
        raise ForeignError(f"{path}: no scan folder can be made: {sequence}; write a cloud with --out {out.name}.ply")
    return sequence


def require_folder_sequence(path: Path, out: Path, scan: ForeignScan) -> PatternSequence:
    """Return the sequence of a scan folder. Raises ForeignError if none can be made."""
    sequence = require_sequence(path, out, scan.description, scan.cameras["left"].images)
    if not scan.rig.scale_known:
        raise ForeignError(
            f"{path}: no scan folder can be made: the calibration has no scale; give the translation's length in mm"
        )
    if scan.wrong:
        raise ForeignError(f"{path}: the images contradict it, and no scan folder can be made; correct it")
    return sequence


def write_own(
    path: Path, out: Path, scan: ForeignScan, points: ForeignCloud, sequence: PatternSequence
) -> dict[str, Any]:
    """Write the scan folder ``out``, and return its JSON-ready summary. Raises ForeignError, StorageError."""
    limits = QualityLimits()
    depth_mm = points.cloud.points_mm[..., 2][points.cloud.mask]
    within = float(np.mean((depth_mm > limits.min_depth_mm) & (depth_mm < limits.max_depth_mm)))
    if within < LEAST_WITHIN:
        raise ForeignError(
            f"{path}: no scan folder can be made: {100 * within:.0f} % of the points lie within the working volume of "
            f"{limits.min_depth_mm:g} to {limits.max_depth_mm:g} mm; write a cloud with --out {out.name}.ply"
        )
    calibration = calibration_of(scan)
    rig = _rig(scan, calibration)
    frames = {side: own_frames(sequence, scan.description, camera.images) for side, camera in scan.cameras.items()}
    water = calibration.water
    record = ScanRecord(
        SequenceInfo.of(sequence), rig.rig_hash, calibration.hash, __version__, None, False, 0,
        water={
            "salinity_psu": water.salinity_psu, "temperature_c": water.temperature_c, "wavelength_nm": water.wavelength_nm,
            "index": water.index,
        },
    )  # fmt: skip
    StoredScan.keep(out, frames, record, Instrument(rig).origin(calibration))
    return {"folder": str(out), "frames": len(sequence), "period_px": sequence.period_px}


def calibration_of(scan: ForeignScan) -> Calibration:
    """Return the calibration with the numbers that the description gives. Raises ForeignError."""
    if scan.rig.calibration is not None:
        return scan.rig.calibration
    water = scan.description.water
    straight = all(camera.lens_in_water for camera in (scan.rig.rig.left, scan.rig.rig.right))
    if any(len(camera.lens.distortion) > 5 for camera in (scan.rig.rig.left, scan.rig.rig.right)):
        raise ForeignError(
            "no scan folder can be made: our calibration files hold the distortion k1, k2, p1, p2, k3 only"
        )
    if not straight and not isinstance(water, Water):
        raise ForeignError(
            "no scan folder can be made: behind ports the index of a scan folder follows from temperature and "
            "salinity; give "
            "water.temperature_c in place of water.index"
        )
    water = water if isinstance(water, Water) else Water(20.0, 0.0, 530.0)
    return Calibration(scan.description.name, METHOD, "unknown", ("images of another rig",), water, scan.rig.rig)


def _rig(scan: ForeignScan, calibration: Calibration) -> Rig:
    """Return the packaged rig with the foreign cameras and projector in place of its own."""
    rig = load_rig()
    serials = calibration.camera_serials or tuple(f"{scan.description.name} {side}" for side in SIDES)

    def camera(side: str, serial: str) -> Any:
        housed: HousedCamera = of_side(scan.rig.rig, side)
        return replace(of_side(rig.camera, side), serial=serial, width_px=housed.width_px, height_px=housed.height_px)

    width_px, height_px = scan.description.projector_px
    return replace(
        rig,
        rig=replace(rig.rig, name=scan.description.name, serial=calibration.rig_serial),
        camera=replace(rig.camera, left=camera("left", serials[0]), right=camera("right", serials[1])),
        projector=replace(rig.projector, width_px=width_px, height_px=height_px),
    )
