"""Owns the names of everything that can go wrong, and what is known about one case of it.

Detectors (ledger, drivers' errors, storage, worker) make a ``Fault``; ``appliance.machine.alerts`` says what the
diver reads. Numbers are evidence: they are stored in the manifest and filled into headlines.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum


class FaultCode(Enum):
    """One name per distinguishable fault. In brackets: the numbers its headline shows."""

    # The recorded sequence
    FRAME_MISSING = "FRAME_MISSING"
    """A frame that was triggered never arrived (received, expected)."""
    FRAME_REPEATED = "FRAME_REPEATED"
    """A block id arrived twice (frame)."""
    FRAME_ORDER = "FRAME_ORDER"
    """Block ids did not increase (frame)."""
    FRAME_TRUNCATED = "FRAME_TRUNCATED"
    """The payload of a frame came short (frame)."""
    FRAME_CORRUPT = "FRAME_CORRUPT"
    """Leader, trailer or id of a frame were damaged (frame)."""
    CAMERA_STUCK = "CAMERA_STUCK"
    """The images do not follow the patterns although their ids run."""
    PATTERN_WRONG = "PATTERN_WRONG"
    """A frame does not show the pattern it should, and no shift by a frame explains it (frame)."""
    SYNC_LOST = "SYNC_LOST"
    """Left and right exposures, or exposures and pulses, are too far apart (skew_ms)."""
    LATE_FLIP = "LATE_FLIP"
    """A pattern reached the screen a vertical blank late (frame)."""
    PROJECTOR_TIMING = "PROJECTOR_TIMING"
    """The images show every pattern shifted by a frame: the projector's latency changed (shift_frames)."""
    PROJECTOR_DARK = "PROJECTOR_DARK"
    """The bright frame is not brighter than the dark one."""
    PULSE_MISSING = "PULSE_MISSING"
    """The board fired fewer pulses than it was armed for (received, expected)."""
    CAPTURE_TIMEOUT = "CAPTURE_TIMEOUT"
    """The sequence did not end in its time."""
    MOVED = "MOVED"
    """Instrument and object moved against each other during the sequence (shift_px)."""
    COMPENSATED = "COMPENSATED"
    """Instrument and object moved, but the motion was found and taken out of the points; no fault of the cloud."""
    TOO_BRIGHT = "TOO_BRIGHT"
    """Too many pixels are saturated (saturated_percent)."""
    TOO_DARK = "TOO_DARK"
    """Too few pixels are modulated by the fringes (coverage_percent)."""
    WATER_DIRTY = "WATER_DIRTY"
    """Specks or backscatter cost much of the object (coverage_percent)."""
    LIGHT_FLICKERS = "LIGHT_FLICKERS"
    """Light that is not the projector's changed from frame to frame, enough to bias phases (harmed_percent)."""
    FRINGES_BENT = "FRINGES_BENT"
    """The exposure shows too few of the projector's bits for fringes to be sines; points are noisier for it (noise_percent)."""
    SCAN_NEAR = "SCAN_NEAR"
    """Most of what a scan sees is nearer than is measured (distance_mm)."""
    SCAN_FAR = "SCAN_FAR"
    """Most of what a scan sees is farther than is measured (distance_mm)."""
    NOTHING_SEEN = "NOTHING_SEEN"
    """A scan in which the projector's light meets nothing."""
    SIDES_EXCHANGED = "SIDES_EXCHANGED"
    """The pictures of the left camera are those of the right one (gap_mm, exchanged_mm)."""
    SCAN_POOR = "SCAN_POOR"
    """Too few points, or too noisy ones, and no judge knows why."""
    AMBIENT = "AMBIENT"
    """Daylight or a torch is brighter than the projector: no exposure helps (ambient_percent)."""

    # Devices
    CAMERA_LOST = "CAMERA_LOST"
    """A camera is not there or no longer answers."""
    CAMERA_SLOW_LINK = "CAMERA_SLOW_LINK"
    """A camera's link negotiated less than SuperSpeed (link_mbps)."""
    CAMERA_REFUSED = "CAMERA_REFUSED"
    """A camera is there but does not take its settings."""
    PROJECTOR_LOST = "PROJECTOR_LOST"
    """The projector's output cannot be opened or driven."""
    DISPLAY_LOST = "DISPLAY_LOST"
    """The diver's screen cannot be opened or driven."""
    BOARD_LOST = "BOARD_LOST"
    """The trigger board is not there or silent."""
    BOARD_RESET = "BOARD_RESET"
    """The trigger board restarted and forgot its settings."""
    VSYNC_LOST = "VSYNC_LOST"
    """The board sees no vertical sync from the projector's video."""
    LASER_ON = "LASER_ON"
    """A laser conducts, or is seen, although it is switched off."""
    LASER_FAILED = "LASER_FAILED"
    """A laser does not conduct although it is switched on: the distance comes from the other's dot."""
    KEYS_LOST = "KEYS_LOST"
    """The key pad is not there or silent."""
    KEY_STUCK = "KEY_STUCK"
    """A key was held for more than 8 s or its coil is faulty; it is masked."""

    # The place
    AIM_DARK = "AIM_DARK"
    """A scan would see too little light to measure by, as aiming shows (detail_dn)."""
    AIM_TURBID = "AIM_TURBID"
    """The water shines while aiming, and nothing is seen through it (detail_dn, glow_dn)."""
    AIM_FAST = "AIM_FAST"
    """Instrument and object move against each other while aiming faster than can be undone (speed_mm_s)."""
    TOO_NEAR = "TOO_NEAR"
    """The object is nearer than the measuring volume (distance_mm)."""
    TOO_FAR = "TOO_FAR"
    """The object is farther than the measuring volume (distance_mm)."""

    # The instrument
    STORAGE_FULL = "STORAGE_FULL"
    """No room for another scan."""
    DISK_READ_ONLY = "DISK_READ_ONLY"
    """The disk takes no changes: mounted for reading only, as systems do after an error of the disk."""
    DISK_REFUSES = "DISK_REFUSES"
    """No space for a scan can be allocated, for another reason than want of space."""
    NOT_SAVED = "NOT_SAVED"
    """The disk refused a scan; it is still in memory."""
    RESTARTED = "RESTARTED"
    """The program had ended by itself, or hung, and was started again."""
    SCAN_RECOVERED = "SCAN_RECOVERED"
    """A scan that was not yet published when the power or the program went was found whole, and is in the gallery."""
    UPDATE_UNDONE = "UPDATE_UNDONE"
    """A new version did not prove itself; the one before is in use again."""
    SETTINGS_LOST = "SETTINGS_LOST"
    """The diver's choices could not be read; the rig file's values hold."""
    UNCALIBRATED = "UNCALIBRATED"
    """No valid calibration of this rig; the design's values are used."""
    VERIFY_CALIBRATION = "VERIFY_CALIBRATION"
    """The ray gaps are no longer those of the calibration: a camera was knocked, or the water is not as stated."""
    LENGTH_ERROR = "LENGTH_ERROR"
    """The ball bar of the step VERIFY came out wrong with the calibration in use (error_percent)."""
    RECONSTRUCTION_FAILED = "RECONSTRUCTION_FAILED"
    """The worker failed, died or took too long; the raw frames are kept."""
    WINDOW = "WINDOW"
    """A camera's window is fogged, dirty or scratched: fringes stay soft at the same place of its images."""
    WARM = "WARM"
    """The housing is warmer than it should be (temperature_c)."""
    HOT = "HOT"
    """Too hot to scan: cooling (temperature_c)."""
    TOO_HOT = "TOO_HOT"
    """The instrument is so hot that it switches itself off (temperature_c)."""
    TEMPERATURE_UNKNOWN = "TEMPERATURE_UNKNOWN"
    """A temperature sensor says nothing: light is rationed."""
    SUPPLY_LOW = "SUPPLY_LOW"
    """The supply voltage is low (supply_v)."""
    LEAK = "LEAK"
    """Water in the housing."""
    INTERNAL = "INTERNAL"
    """The software contradicted itself; see the log."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One case of a fault: what, in the detector's words, with its numbers, and of which device if of one.

    ``device`` is named as in the rig file (``camera.left``). Units of numbers are in their names.
    """

    code: FaultCode
    detail: str = ""
    numbers: Mapping[str, float] = field(default_factory=dict, hash=False)
    device: str | None = None
