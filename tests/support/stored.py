"""Rendered scans as folders on the disk, for everything that starts from stored scans."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from appliance.measure.calibration import file as calibration_file
from appliance.measure.light.exposure import Exposure
from appliance.store.atomic import LocalFileSystem
from appliance.store.manifest import ScanRecord, SequenceInfo
from appliance.store.scan import ScanOrigin, write_raw
from hw_sim.truth import TrueRig
from hw_sim.water.medium import GREEN_NM
from tests.support.commands import ROOT
from tests.support.rendered import RenderedScan
from tests.support.truth import true_calibration


def store(
    scan: RenderedScan,
    folder: Path,
    response_hash: str | None = None,
    exposure_ms: float | None = None,
    gain_db: float = 0.0,
    origin: ScanOrigin | None = None,
    belongs_to: int | None = None,
    wall_time: str = "2031-05-06T07:08:09+00:00",
    calibration_hash: str | None = None,
) -> Path:
    """The raw frames and the manifest of a scan, in a new folder, with the water of its scene. ``origin``: calibration and rig
    that it carries with it; by default those that state its truth. ``belongs_to``: the number of its object. ``calibration_hash``: what the manifest names."""
    water = scan.renderer.scene.water
    record = ScanRecord(
        sequence=SequenceInfo.of(scan.sequence),
        rig_hash="ab" * 32,
        calibration_hash=calibration_hash,
        software_version="0.1.0",
        wall_time=wall_time,
        clock_trusted=True,
        recorded_ns=1,
        response_hash=response_hash,
        exposure=None if exposure_ms is None else Exposure(round(1000.0 * exposure_ms), gain_db),
        object=belongs_to,
        water={"temperature_c": water.temperature_c, "salinity_psu": water.salinity_psu, "wavelength_nm": GREEN_NM},
        temperatures_c={"projector": 41.5, "case": None},
    )
    height_px, width_px = scan.frames["left"].shape[1:]
    carried = origin_of(scan.renderer.truth, width_px, height_px) if origin is None else origin
    write_raw(LocalFileSystem(), folder, folder.name, scan.frames, record, carried)
    return folder


def origin_of(truth: TrueRig, width_px: int, height_px: int) -> ScanOrigin:
    """Return the calibration that states ``truth``, and the packaged rig file with cameras of that size."""
    rig = (ROOT / "appliance" / "store" / "rigs" / "kingfisher.toml").read_text(encoding="utf-8")
    rig = rig.replace("width_px = 1600", f"width_px = {width_px}").replace(
        "height_px = 1200", f"height_px = {height_px}"
    )
    calibration = replace(true_calibration(truth), rig_serial="KF-0001", camera_serials=None)
    return ScanOrigin(calibration_file.encode_calibration(calibration), rig.encode())
