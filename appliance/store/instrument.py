"""Owns what is known of the instrument: its calibration or the drawing's, its water, its cameras' noise, its projector."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

from appliance.base import ContentError
from appliance.measure import (
    IN_AIR,
    NOISE,
    RESPONSE,
    STEPS_MS,
    AcquisitionSettings,
    Calibration,
    CalibrationError,
    CameraFigures,
    CameraNoise,
    Design,
    Exposure,
    Fault,
    FaultCode,
    Misfit,
    Owner,
    Response,
    Span,
    StereoNoise,
    Water,
    WorkingVolume,
    camera_noise,
    design_calibration,
    encode_calibration,
    ladder,
    owner_misfit,
)
from appliance.store.calibration_file import load_calibration
from appliance.store.config import Rig, rig_text
from appliance.store.config.checks import into_light_us
from appliance.store.config.rig import CameraRig
from appliance.store.names import CALIBRATION_IN_AIR, CALIBRATIONS, CURRENT_CALIBRATION
from appliance.store.record import ScanRecord
from appliance.store.scan import ScanOrigin

log = logging.getLogger("kingfisher")

CALIBRATION_FILE = Path(CALIBRATIONS, CURRENT_CALIBRATION)
RESPONSE_FILE = CALIBRATION_FILE.with_name("response.json")
NOISE_FILE = CALIBRATION_FILE.with_name("noise.json")
AIR_FILE = CALIBRATION_FILE.with_name(CALIBRATION_IN_AIR)
KEPT = CALIBRATION_FILE.with_name("kept")
"""Places of the calibration's files, relative to the storage root."""
ONLY_IN_AIR = "the calibration is one in air, a start for calibrating in water; windows and water are not in it"


def calibration_of(rig: Rig) -> tuple[Calibration, tuple[Fault, ...]]:
    """Return the instrument's calibration.

    Where the file in use is damaged, missing, of another instrument or of other cameras: the one before that is kept and
    fits, else the design's; either with the condition UNCALIBRATED, whose detail says which, and whose device
    is the camera that was exchanged (``cameras``: both).
    """
    calibration, problem = _usable(rig, rig.storage.root / CALIBRATION_FILE)
    if problem is None:
        return calibration or design_of(rig), ()
    calibration, detail = None, problem.reason
    # Their names begin with a number that only grows, so that the latest that fits is found first.
    for kept in sorted((rig.storage.root / KEPT).glob("*.json"), reverse=True):
        found, unfit = _usable(rig, kept)
        # After a camera was exchanged, one that does not say which cameras it is of is most likely of those that left.
        if found is not None and unfit is None and (found.camera_serials is not None or not problem.exchanged):
            calibration, detail = found, f"{detail}; {kept.name}, which was in use before, is used"
            break
    log.warning("uncalibrated: %s", detail)
    device = None
    if problem.exchanged:
        # Named for the diver's sake: the alert then says which camera was exchanged.
        device = f"camera.{problem.exchanged[0]}" if len(problem.exchanged) == 1 else "cameras"
    return calibration or design_of(rig), (Fault(FaultCode.UNCALIBRATED, detail, device=device),)


def _usable(rig: Rig, path: Path) -> tuple[Calibration | None, Misfit | None]:
    """Return a file's calibration, and why this instrument cannot measure with it."""
    try:
        calibration = with_volume(load_calibration(path), rig)
    except CalibrationError as error:
        return None, Misfit(str(error))
    if calibration.method == IN_AIR:
        return calibration, Misfit(ONLY_IN_AIR)
    return calibration, owner_misfit(calibration, owner_of(rig))


def response_of(rig: Rig) -> Response | None:
    """Return the projector's response as it was measured; ``None`` where it was not, or cannot be used (which is
    logged)."""
    path = rig.storage.root / RESPONSE_FILE
    try:
        stored = RESPONSE.load(path)
    except ContentError as error:
        log.warning("patterns are drawn without compensation: %s", error)
        return None
    if stored is None:
        return None
    if stored.rig_serial != rig.rig.serial:
        log.warning(
            "patterns are drawn without compensation: response %s is of instrument %s; this one is %s; "
            "measure its own, or remove the file",
            path, stored.rig_serial, rig.rig.serial,
        )  # fmt: skip
        return None
    if stored.trigger_delay_us not in (None, rig.board.trigger_delay_us):
        # Bit planes: what begins at another moment of the frame sees other bits, and another response.
        log.warning(
            "patterns are drawn without compensation: response %s was measured with board.trigger_delay_us = %d, not %d; "
            "measure it again, or remove the file",
            path, stored.trigger_delay_us, rig.board.trigger_delay_us,
        )  # fmt: skip
        return None
    if stored.exposure_us not in (None, exposure_of(rig).time_us):
        log.warning(
            "response %s was measured at %s; the rig file's exposure is %s, at which it may be another",
            path, Exposure(stored.exposure_us or 0).label, exposure_of(rig).label,
        )  # fmt: skip
    log.info("patterns are drawn for the projector's measured response")
    return stored.response


def design_of(rig: Rig) -> Calibration:
    """Return the calibration that the drawing in the rig file stands for."""
    d = rig.design
    design = Design(
        d.principal_distance_mm,
        d.pixel_um,
        d.baseline_mm,
        d.toe_in_deg,
        d.port_distance_mm,
        d.port_thickness_mm,
        d.port_index,
    )
    left = rig.camera.left
    return design_calibration(design, rig.rig.serial, left.width_px, left.height_px, water_of(rig), volume_of(rig))


def volume_of(rig: Rig) -> WorkingVolume:
    """Return the range in which the housing measures."""
    stated = rig.volume
    return WorkingVolume(stated.nearest_mm, stated.working_mm, stated.farthest_mm)


def water_of(rig: Rig) -> Water:
    """Return the water the rig file states."""
    return Water(rig.water.temperature_c, rig.water.salinity_psu, rig.water.wavelength_nm)


def noise_of(rig: Rig, exposure: Exposure | None = None) -> StereoNoise:
    """Return the noise of both cameras, by default at the gain the rig file sets, else at ``exposure``'s."""
    # Steps of exposure set both cameras to the same gain; what the right one's differs by in the rig file is kept.
    more_db = 0.0 if exposure is None else exposure.gain_db - rig.camera.left.gain_db

    def of(camera: CameraRig) -> CameraNoise:
        return camera_noise(camera.full_well_e, camera.read_noise_e, camera.black_level_dn, camera.gain_db + more_db)

    return StereoNoise(of(rig.camera.left), of(rig.camera.right))


def with_measured_noise(rig: Rig) -> Rig:
    """Return the rig with the cameras' noise as it was measured in place of their data sheets'; the rig itself where it was not, or
    the file cannot be used, which is logged.

    A scan carries its rig file as it was understood, so that whoever makes its points again expects the same errors.
    """
    path = rig.storage.root / NOISE_FILE
    try:
        stored = NOISE.load(path)
    except ContentError as error:
        log.warning("the data sheets' noise is believed: %s", error)
        return rig
    if stored is None:
        return rig
    cameras, known = rig.camera, stored.cameras
    if (stored.rig_serial, known.left.serial, known.right.serial) != (
        rig.rig.serial, cameras.left.serial, cameras.right.serial,
    ):  # fmt: skip
        log.warning(
            "the data sheets' noise is believed: %s is of instrument %s with cameras %s and %s, this one is %s with %s and %s; "
            "measure its own, or remove the file",
            path, stored.rig_serial, known.left.serial, known.right.serial,
            rig.rig.serial, cameras.left.serial, cameras.right.serial,
        )  # fmt: skip
        return rig

    def measured(camera: CameraRig, found: CameraFigures) -> CameraRig:
        return replace(
            camera, full_well_e=found.full_well_e, read_noise_e=found.read_noise_e, black_level_dn=found.black_level_dn
        )

    log.info("the cameras' noise is that which was measured")
    both = replace(cameras, left=measured(cameras.left, known.left), right=measured(cameras.right, known.right))
    return replace(rig, camera=both)


def exposure_of(rig: Rig) -> Exposure:
    """Return the exposure of both cameras, as the rig file sets that of the left one."""
    left = rig.camera.left
    return Exposure(round(1000.0 * left.exposure_ms), left.gain_db)


def exposure_of_scan(record: ScanRecord, rig: Rig) -> Exposure:
    """Return the exposure that a stored scan was recorded with; the rig file's where the scan does not say."""
    return record.exposure or exposure_of(rig)


def exposures_label(record: ScanRecord, rig: Rig) -> str:
    """Return the exposure as a label, ``8 ms``; of a pair ``3.2 ms, then 14 ms``."""
    first = exposure_of_scan(record, rig).label
    return first if record.second is None else f"{first}, then {record.second.exposure.label}"


def settings_of(rig: Rig, exposure: Exposure) -> AcquisitionSettings:
    """Return how a sequence is taken with ``exposure``. Raises ValueError for a rig that has no time for any exposure."""
    return AcquisitionSettings(exposure, 1.0 / rig.projector.refresh_hz, noise_of(rig, exposure), exposures_of(rig))


def settings_of_scan(record: ScanRecord, rig: Rig) -> AcquisitionSettings:
    """Return how a stored scan was taken. Raises ValueError for a rig that has no time for any exposure."""
    return settings_of(rig, exposure_of_scan(record, rig))


def exposures_of(rig: Rig) -> tuple[Exposure, ...]:
    """Return the exposures that may be proposed to the diver, from dark to bright."""
    scan = rig.scan
    times_ms = scan.exposures_ms or _whole_sub_frames_ms(rig) or STEPS_MS
    span = Span(scan.shortest_exposure_ms, scan.longest_exposure_ms, scan.most_gain_db, times_ms)
    return ladder(rig.projector.refresh_hz, into_light_us(rig), rig.camera.left.gain_db, span)


def _whole_sub_frames_ms(rig: Rig) -> tuple[float, ...]:
    """Return the exposures that a projector of sub-frames leaves; empty: its rig file names none."""
    projector = rig.projector
    if projector.sub_frames == 1:
        return ()
    return tuple(round(k * projector.sub_frame_ms, 3) for k in range(1, projector.sub_frames + 1))


def origin_of(rig: Rig, calibration: Calibration) -> ScanOrigin:
    """Return what a scan that is taken now carries with it: the calibration in use and the rig as it is understood."""
    return ScanOrigin(encode_calibration(calibration), rig_text(rig).encode())


def instrument_misfit(calibration: Calibration, rig: Rig) -> str | None:
    """Return why a calibration, in air or in water, is not of this instrument and its cameras; ``None`` where it is."""
    found = owner_misfit(calibration, owner_of(rig))
    return None if found is None else found.reason


def owner_of(rig: Rig) -> Owner:
    """Return who the instrument is, for ``appliance.measure.calibration.owner``. A camera with another serial number is never opened."""
    left, right = rig.camera.left, rig.camera.right
    sizes_px = ((left.width_px, left.height_px), (right.width_px, right.height_px))
    return Owner(rig.rig.serial, sizes_px, (left.serial, right.serial))


def with_volume(calibration: Calibration, rig: Rig) -> Calibration:
    """Return the calibration with the volume that the rig file states: the file is its home, a calibration only carries it along."""
    volume = volume_of(rig)
    if calibration.rig.volume == volume:
        return calibration
    return replace(calibration, rig=replace(calibration.rig, volume=volume))


def of_another(calibration: Calibration, rig: Rig) -> str | None:
    """Return why a calibration is not of this instrument, whichever cameras it has now; ``None`` where it is."""
    if calibration.rig_serial == rig.rig.serial:
        return None
    return f"the calibration is of instrument {calibration.rig_serial}; this one is {rig.rig.serial}"
