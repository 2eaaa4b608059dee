"""The instrument as its files describe it: calibration, water, camera noise and projector response."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path

from appliance.base import ContentError, read_bounded
from appliance.measure import (
    CALIBRATION,
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
    decode_calibration,
    design_calibration,
    encode_calibration,
    ladder,
    owner_misfit,
)
from appliance.store.config import Rig, rig_text
from appliance.store.config.checks import into_light_us
from appliance.store.config.rig import CameraRig
from appliance.store.manifest import ScanRecord
from appliance.store.names import AIR_FILE, CALIBRATION_FILE
from appliance.store.scan import ScanOrigin


def load_calibration(path: Path | str) -> Calibration:
    """Read a calibration file. Raises CalibrationError also for a missing or unreadable file."""
    try:
        data = read_bounded(Path(path), CALIBRATION.max_bytes)
    except OSError as error:
        raise CalibrationError(
            f"calibration {path}: cannot be read ({error.strerror}); calibrate, or copy the instrument's file there"
        ) from error
    return decode_calibration(data, f"calibration {path}")


log = logging.getLogger("kingfisher")

RESPONSE_FILE = CALIBRATION_FILE.with_name("response.json")
NOISE_FILE = CALIBRATION_FILE.with_name("noise.json")
"""Files with measurements of the instrument, relative to the storage root."""
ONLY_IN_AIR = "the calibration is an air calibration without ports and water; calibrate in water"


@dataclass(frozen=True, slots=True)
class Instrument:
    """The instrument of a rig file, with the files below its storage root."""

    rig: Rig

    @property
    def calibration_file(self) -> Path:
        """The calibration in use."""
        return self.rig.storage.root / CALIBRATION_FILE

    @property
    def air_file(self) -> Path:
        """The calibration in air, with which one in water begins."""
        return self.rig.storage.root / AIR_FILE

    @property
    def response_file(self) -> Path:
        """The projector's measured response."""
        return self.rig.storage.root / RESPONSE_FILE

    @property
    def noise_file(self) -> Path:
        """The cameras' measured noise."""
        return self.rig.storage.root / NOISE_FILE

    @property
    def kept_folder(self) -> Path:
        """Folder of the calibrations that were in use."""
        return self.calibration_file.with_name("kept")

    def calibration(self) -> tuple[Calibration, tuple[Fault, ...]]:
        """Return the instrument's calibration, and its faults.

        Where the file in use is damaged, missing, of another instrument or of other cameras, it is the latest kept one
        that fits, else the nominal one. Then the fault is UNCALIBRATED: its detail says which one is used, its device is
        the camera that was exchanged (``cameras``: both).
        """
        calibration, problem = self._usable(self.calibration_file)
        if problem is None:
            return calibration or self.design(), ()
        calibration, detail = None, problem.reason
        # Names begin with a number that only grows, so that the latest one that fits comes first.
        for path in sorted(self.kept_folder.glob("*.json"), reverse=True):
            candidate, misfit = self._usable(path)
            # After a camera was exchanged, a calibration without serial numbers is most likely of the former cameras.
            if (
                candidate is not None
                and misfit is None
                and (candidate.camera_serials is not None or not problem.exchanged)
            ):
                calibration, detail = candidate, f"{detail}; {path.name}, the calibration used before, is used"
                break
        log.warning("uncalibrated: %s", detail)
        device = None
        if problem.exchanged:
            # The alert tells the diver which camera was exchanged.
            device = f"camera.{problem.exchanged[0]}" if len(problem.exchanged) == 1 else "cameras"
        return calibration or self.design(), (Fault(FaultCode.UNCALIBRATED, detail, device=device),)

    def _usable(self, path: Path) -> tuple[Calibration | None, Misfit | None]:
        """Return a file's calibration, and the reason why this instrument cannot measure with it."""
        try:
            calibration = self.with_volume(load_calibration(path))
        except CalibrationError as error:
            return None, Misfit(str(error))
        if calibration.method == IN_AIR:
            return calibration, Misfit(ONLY_IN_AIR)
        return calibration, owner_misfit(calibration, self.owner)

    def response(self) -> Response | None:
        """Return the projector's measured response.

        It is ``None`` if it was not measured or cannot be used, which is logged.
        """
        path = self.response_file
        try:
            stored = RESPONSE.load(path)
        except ContentError as error:
            log.warning("patterns are made without response correction: %s", error)
            return None
        if stored is None:
            return None
        if stored.rig_serial != self.rig.rig.serial:
            log.warning(
                "patterns are made without response correction: response %s is of instrument %s; this one is %s; "
                "measure its own, or remove the file",
                path,
                stored.rig_serial,
                self.rig.rig.serial,
            )
            return None
        if stored.trigger_delay_us not in (None, self.rig.board.trigger_delay_us):
            # Bit planes: an exposure that begins at another moment of the frame sees other bits, and another response.
            log.warning(
                "patterns are made without response correction: response %s was measured with "
                "board.trigger_delay_us = %d, "
                "not %d; "
                "measure it again, or remove the file",
                path,
                stored.trigger_delay_us,
                self.rig.board.trigger_delay_us,
            )
            return None
        if stored.exposure_us not in (None, self.exposure.time_us):
            log.warning(
                "response %s was measured at %s; the rig file's exposure is %s, for which the response may differ",
                path,
                Exposure(stored.exposure_us or 0).label,
                self.exposure.label,
            )
        log.info("patterns are made for the projector's measured response")
        return stored.response

    def design(self) -> Calibration:
        """Return the nominal calibration of the rig file."""
        d = self.rig.design
        design = Design(
            d.principal_distance_mm,
            d.pixel_um,
            d.baseline_mm,
            d.toe_in_deg,
            d.port_distance_mm,
            d.port_thickness_mm,
            d.port_index,
        )
        left = self.rig.camera.left
        return design_calibration(design, self.rig.rig.serial, left.width_px, left.height_px, self.water, self.volume)

    @property
    def volume(self) -> WorkingVolume:
        """The range in which the housing measures."""
        stated = self.rig.volume
        return WorkingVolume(stated.nearest_mm, stated.working_mm, stated.farthest_mm)

    @property
    def water(self) -> Water:
        """The water the rig file states."""
        return Water(self.rig.water.temperature_c, self.rig.water.salinity_psu, self.rig.water.wavelength_nm)

    def noise(self, exposure: Exposure | None = None) -> StereoNoise:
        """Return the noise of both cameras at the gain of ``exposure``, by default at the rig file's."""
        # An exposure sets the gain of both cameras; the right one keeps its difference in the rig file.
        more_db = 0.0 if exposure is None else exposure.gain_db - self.rig.camera.left.gain_db

        def of(camera: CameraRig) -> CameraNoise:
            return camera_noise(
                camera.full_well_e, camera.read_noise_e, camera.black_level_dn, camera.gain_db + more_db
            )

        return StereoNoise(of(self.rig.camera.left), of(self.rig.camera.right))

    def with_measured_noise(self) -> Rig:
        """Return the rig with the cameras' measured noise instead of that of their data sheets.

        Return the rig itself where the noise was not measured or its file cannot be used, which is logged. A scan
        carries its rig file with this noise, so that reprocessing expects the same errors.
        """
        path = self.noise_file
        try:
            stored = NOISE.load(path)
        except ContentError as error:
            log.warning("the noise of the data sheets is used: %s", error)
            return self.rig
        if stored is None:
            return self.rig
        cameras, measured_cameras = self.rig.camera, stored.cameras
        if (stored.rig_serial, measured_cameras.left.serial, measured_cameras.right.serial) != (
            self.rig.rig.serial,
            cameras.left.serial,
            cameras.right.serial,
        ):
            log.warning(
                "the noise of the data sheets is used: %s is of instrument %s with cameras %s and %s, this one is %s "
                "with %s and %s; "
                "measure its own, or remove the file",
                path,
                stored.rig_serial,
                measured_cameras.left.serial,
                measured_cameras.right.serial,
                self.rig.rig.serial,
                cameras.left.serial,
                cameras.right.serial,
            )
            return self.rig

        def measured(camera: CameraRig, figures: CameraFigures) -> CameraRig:
            return replace(
                camera,
                full_well_e=figures.full_well_e,
                read_noise_e=figures.read_noise_e,
                black_level_dn=figures.black_level_dn,
            )

        log.info("the measured noise of the cameras is used")
        updated = replace(
            cameras,
            left=measured(cameras.left, measured_cameras.left),
            right=measured(cameras.right, measured_cameras.right),
        )
        return replace(self.rig, camera=updated)

    @property
    def exposure(self) -> Exposure:
        """The exposure of both cameras, as the rig file sets that of the left one."""
        left = self.rig.camera.left
        return Exposure(round(1000.0 * left.exposure_ms), left.gain_db)

    def exposure_of_scan(self, record: ScanRecord) -> Exposure:
        """Return the exposure that a stored scan was recorded with.

        It is the rig file's where the scan has none.
        """
        return record.exposure or self.exposure

    def exposures_label(self, record: ScanRecord) -> str:
        """Return the exposure as a label, ``8 ms``; of a bracket ``3.2 ms, then 14 ms``."""
        first = self.exposure_of_scan(record).label
        return first if record.second is None else f"{first}, then {record.second.exposure.label}"

    def settings(self, exposure: Exposure) -> AcquisitionSettings:
        """Return the acquisition settings of a sequence with ``exposure``.

        Raises ValueError for a rig that has no time for any exposure.
        """
        return AcquisitionSettings(exposure, 1.0 / self.rig.projector.refresh_hz, self.noise(exposure), self.exposures)

    def settings_of_scan(self, record: ScanRecord) -> AcquisitionSettings:
        """Return the acquisition settings of a stored scan.

        Raises ValueError for a rig that has no time for any exposure.
        """
        return self.settings(self.exposure_of_scan(record))

    @property
    def exposures(self) -> tuple[Exposure, ...]:
        """The exposures that may be proposed to the diver, from dark to bright."""
        scan = self.rig.scan
        times_ms = scan.exposures_ms or self._whole_sub_frames_ms() or STEPS_MS
        span = Span(scan.shortest_exposure_ms, scan.longest_exposure_ms, scan.most_gain_db, times_ms)
        return ladder(self.rig.projector.refresh_hz, into_light_us(self.rig), self.rig.camera.left.gain_db, span)

    def _whole_sub_frames_ms(self) -> tuple[float, ...]:
        """Return the exposures of whole sub-frames; empty for a projector without sub-frames."""
        projector = self.rig.projector
        if projector.sub_frames == 1:
            return ()
        return tuple(round(k * projector.sub_frame_ms, 3) for k in range(1, projector.sub_frames + 1))

    def origin(self, calibration: Calibration) -> ScanOrigin:
        """Return the files that a new scan carries: the calibration in use and the rig file."""
        return ScanOrigin(encode_calibration(calibration), rig_text(self.rig).encode())

    def misfit(self, calibration: Calibration) -> str | None:
        """Return the reason why a calibration is not of this instrument and its cameras, or ``None``."""
        mismatch = owner_misfit(calibration, self.owner)
        return None if mismatch is None else mismatch.reason

    @property
    def owner(self) -> Owner:
        """Serial numbers and image sizes that identify the instrument.

        A camera with another serial number is never opened.
        """
        left, right = self.rig.camera.left, self.rig.camera.right
        sizes_px = ((left.width_px, left.height_px), (right.width_px, right.height_px))
        return Owner(self.rig.rig.serial, sizes_px, (left.serial, right.serial))

    def with_volume(self, calibration: Calibration) -> Calibration:
        """Return the calibration with the working volume of the rig file instead of its own."""
        volume = self.volume
        if calibration.rig.volume == volume:
            return calibration
        return replace(calibration, rig=replace(calibration.rig, volume=volume))

    def of_another(self, calibration: Calibration) -> str | None:
        """Return the reason why a calibration is of another instrument, or ``None``; cameras do not count."""
        if calibration.rig_serial == self.rig.rig.serial:
            return None
        return f"the calibration is of instrument {calibration.rig_serial}; this one is {self.rig.rig.serial}"
