"""A scan of a plane on the disk, of a small instrument as the rig file draws it: the least that desk work starts from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from appliance.measure.light.patterns import build_sequence
from appliance.measure.points.pipeline import Pipeline
from appliance.store.config import Rig, load_rig
from appliance.store.instrument import Instrument
from appliance.store.library import Library
from appliance.store.manifest import ScanRecord, SequenceInfo
from tests.support import synthetic

NORMAL = np.array([0.0, 0.1, 1.0]) / np.hypot(0.1, 1.0)


def small_rig(root: Path) -> Rig:
    """The packaged rig with small cameras and its storage at ``root``."""
    rig = load_rig()
    cameras = replace(
        rig.camera,
        left=replace(rig.camera.left, width_px=400, height_px=300),
        right=replace(rig.camera.right, width_px=400, height_px=300),
    )
    return replace(
        rig, camera=cameras, design=replace(rig.design, pixel_um=18.0), storage=replace(rig.storage, root=root)
    )


def store_plane(rig: Rig, nearer_mm: float = 0.0) -> tuple[Path, np.ndarray]:
    """Return its folder and its points. ``nearer_mm``: than the middle of the volume."""
    cal = Instrument(rig).design()
    sequence = build_sequence(16)
    frames = synthetic.wall(cal, sequence, NORMAL, nearer_mm)
    pipeline = Pipeline(cal, cal.water, sequence)
    synthetic.push_all(pipeline, frames)
    pipeline.coarse()
    cloud = pipeline.full()
    record = ScanRecord(
        sequence=SequenceInfo.of(sequence),
        rig_hash=rig.rig_hash,
        calibration_hash=cal.hash,
        software_version="0",
        wall_time=None,
        clock_trusted=False,
        recorded_ns=0,
        water={"temperature_c": 20.0, "salinity_psu": 0.0, "wavelength_nm": 530.0},
    )
    library = Library(rig.storage.root)
    library.prepare()
    return library.begin(frames, record, Instrument(rig).origin(cal)).publish(record, cloud), cloud.points_mm
