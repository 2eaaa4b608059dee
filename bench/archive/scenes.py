"""Stored scans for measuring the archive: random scenes of both simulated worlds, as folders of an instrument.

A folder is made once and kept, as a whole or not at all, so that an interrupted run continues.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from appliance.measure.calibration import file as calibration_file
from appliance.measure.light.exposure import Exposure
from appliance.store.atomic import LocalFileSystem
from appliance.store.config import default_rig_path, parse_rig
from appliance.store.manifest import ScanRecord, SequenceInfo
from appliance.store.scan import ScanOrigin, write_raw
from bench.outside.draws import scene_world
from bench.outside.scan import SEQUENCE
from bench.outside.stated import stated_truth
from bench.outside.world import Frames, chosen_exposure, expose
from hw_sim.outside import ALL

FULL_PX = (1600, 1200)
FAMILIES = {"ordinary": (), "outside": ALL}
SEED = 4711
"""Seed of the scenes; no constant of the product was chosen with them."""


@dataclass(frozen=True, slots=True)
class RandomScan:
    """One random scan and its scene."""

    folder: Path
    world: str
    object: str
    texture: str
    attenuation_per_m: float


@dataclass(frozen=True, slots=True)
class _Taken:
    frames: Frames
    exposure: Exposure
    origin: ScanOrigin
    calibration_hash: str
    water: Mapping[str, float | None]


def drawn_scans(
    root: Path, world: str, count: int, size_px: tuple[int, int], say: Callable[[str], None]
) -> list[RandomScan]:
    """Return ``count`` stored scans of ``world`` (``ordinary`` or ``outside``) below ``root``/scans; missing ones are
    made."""
    scans = []
    for number in range(count):
        folder = root / "scans" / f"{number + 1:06d}"
        drawn = scene_world(SEED, number, FAMILIES[world], (8, 6)).scene
        if not folder.exists():
            say(f"{world} {number + 1} of {count}")
            _store(folder, _take(world, number, size_px))
        scans.append(RandomScan(folder, world, drawn.object, drawn.texture, drawn.water.attenuation_per_m))
    return scans


def _take(world: str, number: int, size_px: tuple[int, int]) -> _Taken:
    drawn = scene_world(SEED, number, FAMILIES[world], size_px)
    renderer = drawn.renderer()
    exposure = chosen_exposure(renderer, SEQUENCE)
    stated = stated_truth(drawn.rig, drawn.scene)
    text = rig_text(size_px)
    rig = parse_rig(text, "the packaged rig file")
    serials = (rig.camera.left.serial, rig.camera.right.serial)
    calibration = replace(stated.calibration, rig_serial=rig.rig.serial, camera_serials=serials)
    encoded = calibration_file.encode_calibration(calibration)
    water = {
        "temperature_c": stated.water.temperature_c,
        "salinity_psu": stated.water.salinity_psu,
        "wavelength_nm": stated.water.wavelength_nm,
        "index": stated.water.index,
    }
    origin = ScanOrigin(encoded, text.encode())
    return _Taken(
        expose(renderer, SEQUENCE, exposure), exposure, origin, calibration_file.decode_calibration(encoded).hash, water
    )


def _store(folder: Path, scan: _Taken) -> None:
    record = ScanRecord(
        sequence=SequenceInfo.of(SEQUENCE),
        rig_hash="ab" * 32,
        calibration_hash=scan.calibration_hash,
        software_version="0.1.0",
        wall_time=f"2031-05-06T07:{int(folder.name) // 60 % 60:02d}:{int(folder.name) % 60:02d}+00:00",
        clock_trusted=True,
        recorded_ns=int(folder.name) * 5_000_000_000,
        exposure=scan.exposure,
        water=scan.water,
    )
    draft = folder.with_name(f".{folder.name}")
    shutil.rmtree(draft, ignore_errors=True)
    draft.parent.mkdir(parents=True, exist_ok=True)
    write_raw(LocalFileSystem(), draft, folder.name, scan.frames, record, scan.origin)
    draft.rename(folder)


def rig_text(size_px: tuple[int, int]) -> str:
    """Return the packaged rig file with cameras of another size."""
    text = default_rig_path().read_text(encoding="utf-8")
    for name, full, size in zip(("width_px", "height_px"), FULL_PX, size_px, strict=True):
        text = re.sub(rf"(?m)^{name} = {full}\b", f"{name} = {size}", text)
    return text
