"""Owns the step ``plane``: one scan of a plane, recorded, stored and worked through as any scan is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

import appliance
from appliance.bringup.finding import BringupError
from appliance.bringup.guide import StepOutcome
from appliance.bringup.person import MOST_ASKED, numbered
from appliance.bringup.plane_check import SATURATED_DN, PlaneSeen, curve_of, judge_curve, judge_plane, next_exposure
from appliance.bringup.plane_ripple import CoordinateRipple, SmoothPlane, ripple_of, smooth_plane
from appliance.bringup.plots import plot, png
from appliance.bringup.response_check import ResponseShape
from appliance.capture.scan import CaptureReport, ScanRecorder, ScanSettings
from appliance.capture.store import FrameStore
from appliance.evaluation.flatness import Flatness, flatness
from appliance.evaluation.plane import fit_plane
from appliance.evaluation.points import NotFound
from appliance.instrument import calibration_of, exposure_of, exposures_of, origin_of, response_of, with_measured_noise
from appliance.offline.reconstruct import work_through
from appliance.patterns.sequence import Direction, PatternSequence
from appliance.reconstruct.decode.decoder import CameraDecoder
from appliance.scan.exposure import Exposure
from appliance.scan.sides import SIDES
from appliance.service.air_live import opened
from appliance.service.bringup.projector import wall
from appliance.service.bringup.workplace import Workplace
from appliance.service.devices import Devices
from appliance.service.recording import DrawnPatterns
from appliance.storage import scan as stored
from appliance.storage.library import Library
from appliance.storage.record import ScanRecord, SequenceInfo
from appliance.storage.scan import ScanError
from drivers.output.gl import open_gl

TRIES = 3
"""Recordings of the scan: a late flip happens, the same fault thrice is one."""
LIT_DN = 20
"""Grey values of a bright image over its dark one from which a pixel is lit."""
LEAST_LIT = 0.2
"""Share of a bright image that must be lit; else the plane is asked for again."""
Frames = dict[str, NDArray[np.uint8]]


@dataclass(frozen=True, slots=True, eq=False)
class _SideDecoded:
    """One camera's part in the scan, decoded."""

    planes: dict[Direction, SmoothPlane]
    filled: float
    saturated: float


def plane_step(at: Workplace) -> StepOutcome:
    """Do the step. Raises DeviceError, BringupError, GivenUp, StorageError."""
    with open_gl() as gl:
        # The response, if it was measured, is drawn for: what is left of the ripple is what scans have.
        response = response_of(at.rig)
        patterns = DrawnPatterns(gl, at.rig, at.rig.scan.period_px, response)
        sequence = patterns.sequence
        exposure = exposure_of(at.rig)
        for turn in range(MOST_ASKED):
            at.person.ask(numbered(wall(at), turn))
            report, frames, exposure = _exposed(
                partial(_recorded, at, patterns), sequence, exposures_of(at.rig), exposure
            )
            if all(_lit(one, sequence).mean() >= LEAST_LIT for one in frames.values()):
                break
    scan_id = _stored(at, report, frames, sequence, exposure, None if response is None else response.hash)
    at.say("decoding", None)
    sides = {side: _decoded(sequence, frames[side]) for side in SIDES}
    shape, curve = (None, None) if response is not None else _response(sequence, frames, sides)
    flat, why_not, faults = _worked_through(at, scan_id)
    seen = PlaneSeen(
        scan=scan_id,
        period_px=sequence.period_px,
        ripple=_ripples(sides, sequence.period_px),
        exposure=exposure,
        filled={side: one.filled for side, one in sides.items()},
        saturated={side: one.saturated for side, one in sides.items()},
        response=shape,
        flatness=flat,
        why_not_flat=why_not,
        faults=faults,
    )
    pictures = {
        f"plane_{side}.png": (f"The plane in white light ({side} camera)", png(frames[side][sequence.bright]))
        for side in SIDES
    }
    if curve is not None:
        pictures["plane_light.png"] = "Light of the plane by code, as the fringes show it", curve
    return StepOutcome(judge_plane(seen), {}, pictures)


def _exposed(
    record: Callable[[Exposure], tuple[CaptureReport, Frames]],
    sequence: PatternSequence,
    allowed: Sequence[Exposure],
    exposure: Exposure,
) -> tuple[CaptureReport, Frames, Exposure]:
    """Record the plane with the longest of the allowed exposures that does not saturate it, and return which that was."""
    report, frames = record(exposure)
    # The rig file's exposure is that of the dive; a white plane in air is brighter than most of what lies under water.
    for _ in allowed:
        saturated = max(_saturated(one, sequence) for one in frames.values())
        darker = next_exposure(allowed, exposure, saturated)
        if darker is None:
            break
        exposure = darker
        report, frames = record(exposure)
    return report, frames, exposure


def _recorded(at: Workplace, patterns: DrawnPatterns, exposure: Exposure) -> tuple[CaptureReport, Frames]:
    """Record one sequence whose witnesses all agree. Raises DeviceError, BringupError."""
    rig, sequence = at.rig, patterns.sequence
    settings = ScanSettings(
        rig.projector.refresh_hz, exposure.time_us, rig.board.trigger_delay_us, rig.projector.latency_blanks
    )
    left = rig.camera.left
    with (
        FrameStore(len(sequence), left.height_px, left.width_px) as store,
        Devices(rig, at.wires, patterns.load) as devices,
    ):
        grabbers, board, projector = opened(devices, at.wires.clock)
        devices.expose(exposure)
        recorder = ScanRecorder(grabbers, board, projector, at.wires.clock, settings)
        fault = None
        for _ in range(TRIES):
            at.say("scanning", None)
            report = recorder.record(sequence, store, lambda _side, _index: None, lambda: None)
            fault = report.fault
            if fault is None:
                return report, {side: store.frames(side)[: len(sequence)].copy() for side in SIDES}
    assert fault is not None
    raise BringupError(
        f"{TRIES} scans failed one after the other: {fault.code.value}: {fault.detail}; do step trigger again"
    )


def _lit(frames: NDArray[np.uint8], sequence: PatternSequence) -> NDArray[np.bool_]:
    """Return the pixels (h, w) that the projector lights."""
    bright, dark = (frames[k].astype(np.int16) for k in (sequence.bright, sequence.dark))
    return np.asarray(bright - dark >= LIT_DN)


def _saturated(frames: NDArray[np.uint8], sequence: PatternSequence) -> float:
    """Return the share of what the projector lights that is saturated in its white light."""
    lit = _lit(frames, sequence)
    return float(((frames[sequence.bright] >= SATURATED_DN) & lit).sum() / max(1, int(lit.sum())))


def _stored(
    at: Workplace,
    report: CaptureReport,
    frames: Frames,
    sequence: PatternSequence,
    exposure: Exposure,
    response_hash: str | None,
) -> str:
    """Store the scan among the instrument's others, and return its number. Raises StorageError."""
    library = Library(at.rig.storage.root)
    library.prepare()
    calibration, _ = calibration_of(at.rig)
    date, water = at.wires.calendar.today(), at.rig.water
    record = ScanRecord(
        sequence=SequenceInfo.of(sequence),
        rig_hash=at.rig.rig_hash,
        calibration_hash=calibration.hash,
        software_version=appliance.__version__,
        wall_time=date.utc.isoformat(timespec="seconds"),
        clock_trusted=date.kept,
        recorded_ns=at.wires.clock.now_ns(),
        response_hash=response_hash,
        exposure=exposure,
        water={
            "temperature_c": water.temperature_c,
            "salinity_psu": water.salinity_psu,
            "wavelength_nm": water.wavelength_nm,
        },
        ledger=report.ledger.as_dict(),
    )
    pending = library.begin(frames, record, origin_of(at.rig, calibration))
    pending.publish(record)
    return pending.scan_id


def _decoded(sequence: PatternSequence, frames: NDArray[np.uint8]) -> _SideDecoded:
    decoder = CameraDecoder(sequence, frames.shape[2], frames.shape[1])
    for index in range(len(sequence)):
        decoder.push(frames, index)
    decoder.finish()
    found = {
        Direction.X: smooth_plane(decoder.p_px, sequence.period_px),
        Direction.Y: smooth_plane(decoder.q_px, sequence.period_px),
    }
    return _SideDecoded(
        {direction: plane for direction, plane in found.items() if plane is not None},
        float(np.isfinite(decoder.p_px).mean()),
        _saturated(frames, sequence),
    )


def _ripples(sides: dict[str, _SideDecoded], period_px: int) -> dict[str, CoordinateRipple]:
    return {
        f"{side} {direction.value}": ripple_of(plane, period_px)
        for side, one in sides.items()
        for direction, plane in one.planes.items()
    }


def _response(
    sequence: PatternSequence, frames: Frames, sides: dict[str, _SideDecoded]
) -> tuple[ResponseShape | None, bytes | None]:
    """Return the response that the camera that sees more codes shows, and its picture."""
    curves = {side: curve_of(sequence, frames[side], one.planes) for side, one in sides.items() if one.planes}
    if not curves:
        return None, None
    codes, even, odd = max(curves.values(), key=lambda one: len(one[0]))
    # A curve that cannot be judged is not drawn either: it would look like one.
    shape = judge_curve(codes, even, odd)
    if shape is None:
        return None, None
    return shape, plot({"even rows": (codes, even), "odd rows": (codes, odd)}, "code", "share of bright over dark")


def _worked_through(at: Workplace, scan_id: str) -> tuple[Flatness | None, str, tuple[str, ...]]:
    """Return how flat the stored scan's cloud is, else why that is not known, and what the judges hold against it."""
    rig = with_measured_noise(at.rig)
    calibration, conditions = calibration_of(rig)
    # The drawing's geometry would make a cloud, too, whose flatness says nothing about the instrument.
    if conditions:
        return None, "there is no calibration yet; calibrate next (docs/calibration.md)", ()
    scan = stored.load(Library(rig.storage.root).entry(scan_id).folder)
    try:
        worked = work_through(scan, rig, calibration, lambda what: at.say(what, None))
    except ScanError as error:
        return None, str(error), (str(error),)
    faults = tuple(f"{fault.code.value}: {fault.detail}" for fault in worked.faults)
    # Faults of the judges are told beside it: a scan that they refuse may still be flat.
    fit = fit_plane(worked.cloud)
    if isinstance(fit, NotFound):
        return None, fit.reason, faults
    return flatness(fit), "", faults
