"""What a scan's noise says of the cameras is what a data sheet would say, at 0 dB, and what no camera has is refused."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from appliance.calibrate.photon_transfer import MeasuredNoise, NoiseError
from appliance.desk.measuring import ExposureCheck, noise_to_store
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.noise import CameraNoise
from appliance.measure.light.patterns import build_sequence
from appliance.store.atomic import LocalFileSystem
from appliance.store.config import Rig, load_rig
from appliance.store.instrument import Instrument
from appliance.store.manifest import ScanRecord, SequenceInfo
from appliance.store.scan import StoredScan, write_raw
from tests.appliance.store.scenes import ORIGIN

RIG = Path(__file__).parents[3] / "hw_sim" / "rigs" / "small.toml"
SEQUENCE = build_sequence(16)
EXPECTED = CameraNoise(255.0 / 13_000.0, 0.5, 1.0)


@pytest.fixture
def rig() -> Rig:
    """An instrument whose right camera is set 3 dB higher than its left one."""
    rig = load_rig(RIG)
    left, right = replace(rig.camera.left, gain_db=1.0), replace(rig.camera.right, gain_db=4.0)
    return replace(rig, camera=replace(rig.camera, left=left, right=right))


def scan(folder: Path, exposure: Exposure | None) -> Path:
    """A stored scan that shows nothing: what it shows was measured already."""
    frames = np.full((len(SEQUENCE), 8, 8), 7, np.uint8)
    record = ScanRecord(
        sequence=SequenceInfo.of(SEQUENCE), rig_hash="ab" * 32, calibration_hash=None, software_version="0.1.0",
        wall_time="2031-05-06T07:08:09+00:00", clock_trusted=True, recorded_ns=1, exposure=exposure,
    )  # fmt: skip
    write_raw(LocalFileSystem(), folder, folder.name, {"left": frames, "right": frames}, record, ORIGIN)
    return folder


def measured(full_well_e: float, read_e: float, black_dn: float) -> MeasuredNoise:
    """What a camera with these figures at the gain of the scan shows."""
    per_e = 255.0 / full_well_e
    variance_dn2 = (read_e * per_e) ** 2 + per_e * (100.0 - black_dn) + 1.0 / 12.0
    return MeasuredNoise(per_e, (100.0, variance_dn2), black_dn, 50_000)


FOUND = {"left": (measured(4_000.0, 12.0, 6.0), EXPECTED), "right": (measured(3_000.0, 9.0, 2.0), EXPECTED)}


def test_figures_are_those_at_no_gain_whatever_each_camera_was_set_to(rig: Rig, tmp_path: Path) -> None:
    for exposure, gains_db in ((None, (1.0, 4.0)), (Exposure(8_000, 6.0), (6.0, 9.0))):
        stored = noise_to_store(rig, scan(tmp_path / str(gains_db[0]), exposure), FOUND)
        assert (stored.rig_serial, stored.made_from) == ("KF-SIM", (str(gains_db[0]),))
        assert (stored.cameras.left.serial, stored.cameras.right.serial) == ("KF-CAM-L", "KF-CAM-R")
        # Twenty decibels are ten times the grey value of an electron.
        assert stored.cameras.left.full_well_e == pytest.approx(4_000.0 * 10.0 ** (gains_db[0] / 20.0))
        assert stored.cameras.right.full_well_e == pytest.approx(3_000.0 * 10.0 ** (gains_db[1] / 20.0))
        assert (stored.cameras.left.read_noise_e, stored.cameras.right.read_noise_e) == pytest.approx((12.0, 9.0))
        assert (stored.cameras.left.black_level_dn, stored.cameras.right.black_level_dn) == (6.0, 2.0)


def test_an_instrument_with_these_figures_expects_the_noise_that_was_seen(rig: Rig, tmp_path: Path) -> None:
    folder = scan(tmp_path / "1", Exposure(8_000, 6.0))
    stored, cameras = noise_to_store(rig, folder, FOUND), {}
    for side in ("left", "right"):
        one, camera = getattr(stored.cameras, side), getattr(rig.camera, side)
        figures = {name: getattr(one, name) for name in ("full_well_e", "read_noise_e", "black_level_dn")}
        cameras[side] = replace(camera, **figures)
    used = replace(rig, camera=replace(rig.camera, **cameras))
    expected = Instrument(used).noise(
        Instrument(used).exposure_of_scan(StoredScan.load(folder, only_raw=True).manifest.record)
    )
    for side in ("left", "right"):
        seen_dn2 = FOUND[side][0].variance_at_dn2[1]
        assert getattr(expected, side).variance_dn2(100.0) == pytest.approx(seen_dn2)


@pytest.mark.parametrize(
    ("side", "figures", "said"),
    [
        ("left", (499.0, 12.0, 6.0), "full_well_e of the left camera would be 499; allowed are 500..900000"),
        ("right", (9.1e5, 12.0, 6.0), "full_well_e of the right camera would be 9.1e"),
        ("right", (4_000.0, 901.0, 6.0), "read_noise_e of the right camera would be 901; allowed are 0..900"),
        ("left", (4_000.0, 12.0, 63.5), "black_level_dn of the left camera would be 63.5; allowed are 0..63"),
        ("left", (500.0001, 0.0, 63.0), None),
        ("right", (899_999.0, 899.0, 0.0), None),
    ],
)
def test_figures_that_no_camera_has_are_refused(
    side: str, figures: tuple[float, float, float], said: str | None, tmp_path: Path
) -> None:
    found = {one: (measured(4_000.0, 12.0, 6.0), EXPECTED) for one in ("left", "right")}
    found[side] = measured(*figures), EXPECTED
    folder = scan(tmp_path / "1", Exposure(8_000))
    with nullcontext() if said is None else pytest.raises(NoiseError, match=f"^{said}"):
        assert noise_to_store(load_rig(RIG), folder, found).made_from == ("1",)


def test_an_exposure_is_straight_if_points_are_a_tenth_noisier_at_most() -> None:
    for noisier, straight in ((1.0, True), (1.1, True), (1.101, False)):
        assert ExposureCheck("1", Exposure(8_000), 500, 0.1, 0.02, noisier).straight == straight
