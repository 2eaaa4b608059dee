"""Small values of a scan: noise after EMVA 1288, sides, faults as verdicts, which move an overlap asks for, and what is taken for granted."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import pytest

from appliance.config.load import default_rig_path, load_rig
from appliance.scan.acquisition import AcquisitionSettings
from appliance.scan.exposure import Exposure
from appliance.scan.fault import Fault, FaultCode
from appliance.scan.guidance import LOST, Guidance, Move
from appliance.scan.noise import MAD_TO_SIGMA, TYPICAL, CameraNoise, StereoNoise, camera_noise
from appliance.scan.overlap import UNKNOWN, Overlap
from appliance.scan.sides import SIDES, of_side
from appliance.scan.verdict import Verdict

CAMERA = CameraNoise(read_dn=0.9, dn_per_e=0.05, black_dn=3.0)


def test_of_what_nothing_is_said_the_shipped_rig_file_holds() -> None:
    rig, usual = load_rig(default_rig_path()), AcquisitionSettings()
    camera = rig.camera.left
    assert usual.frame_s == pytest.approx(1.0 / rig.projector.refresh_hz)
    assert usual.exposure == Exposure(round(1000.0 * camera.exposure_ms), camera.gain_db)
    assert usual.steps == (usual.exposure,), "and none but its own exposure may be proposed"
    assert camera_noise(camera.full_well_e, camera.read_noise_e, camera.black_level_dn, 0.0) == TYPICAL


def test_an_image_scatters_as_each_of_its_grey_values() -> None:
    grey_dn = np.array([[0.0, 3.0], [4.0, 255.0]])
    variance = CAMERA.variance_dn2(grey_dn)
    assert variance.tolist() == [[CAMERA.variance_dn2(float(v)) for v in row] for row in grey_dn]
    assert variance[0, 0] == variance[0, 1] == pytest.approx(0.81), "below black there is no light to be missing"
    assert variance[1, 1] == pytest.approx(0.81 + 0.05 * 252.0)
    assert CAMERA.dark_variance_dn2 + 0.05 * 200.0 == pytest.approx(CAMERA.variance_dn2(200.0)), "as kernels add it"
    assert CAMERA.variance_dn2(np.zeros(3, np.float32)).dtype == np.float32
    assert CAMERA.variance_dn2(np.zeros(3)).dtype == np.float64


def test_electrons_scatter_by_their_root_and_in_the_dark_as_the_data_sheet_says() -> None:
    """EMVA 1288: of 10,000 electrons 100 are noise, one part in a hundred of the saturated grey value."""
    camera = camera_noise(full_well_e=10_000.0, read_noise_e=0.0, black_dn=0.0, gain_db=0.0)
    assert math.sqrt(camera.variance_dn2(255.0) - camera.variance_dn2(0.0)) == pytest.approx(2.55)
    assert camera.variance_dn2(0.0) == pytest.approx(1.0 / 12.0), "what is left is rounding to whole grey values"
    # 20 of 10,000 electrons are 0.51 of 255 grey values; at twice the gain they are twice as many.
    for gain_db, factor in ((0.0, 1.0), (20.0 * math.log10(2.0), 2.0), (20.0, 10.0)):
        camera = camera_noise(full_well_e=10_000.0, read_noise_e=20.0, black_dn=4.0, gain_db=gain_db)
        assert camera.black_dn == 4.0
        assert camera.variance_dn2(4.0) == pytest.approx((0.51 * factor) ** 2 + 1.0 / 12.0)
        assert camera.dn_per_e == pytest.approx(0.0255 * factor)
    assert MAD_TO_SIGMA * NormalDist().inv_cdf(0.75) == pytest.approx(1.0, abs=1e-4)


def test_each_camera_gets_its_own_part_and_a_third_one_there_is_not() -> None:
    both = StereoNoise(CAMERA, CameraNoise(0.6, 0.02, 2.0))
    assert [of_side(both, side) for side in SIDES] == [both.left, both.right]
    with pytest.raises(ValueError, match="middle"):
        of_side(both, "middle")


def test_a_fault_is_a_verdict_that_was_not_passed_and_another_one_with_other_numbers() -> None:
    numbers = {"received": 23.0, "expected": 24.0}
    fault = Fault(FaultCode.FRAME_MISSING, "23 of 24 frames arrived", numbers, "camera.left")
    told = Verdict("ledger", False, numbers, "FRAME_MISSING: 23 of 24 frames arrived")
    assert Verdict.failed("ledger", fault) == told
    assert Verdict.failed("ledger", Fault(FaultCode.LEAK)).text == "LEAK", "no colon with nothing behind it"
    faults = [Fault(FaultCode.FRAME_MISSING, "", {"received": received}) for received in (22.0, 23.0, 23.0)]
    assert len(set(faults)) == 2


@pytest.mark.parametrize(
    ("share", "move"),
    [(0.0, Move.GO_BACK), (0.39, Move.GO_BACK), (0.41, Move.SCAN_NOW), (0.59, Move.SCAN_NOW), (0.61, Move.GO_ON)],
)
def test_half_is_good_less_asks_back_more_asks_on_and_what_cannot_be_told_is_no_guidance(
    share: float, move: Move
) -> None:
    assert Guidance(Overlap(share)).move is move
    assert LOST.move is Move.GO_BACK
    with pytest.raises(ValueError, match="guidance"):
        Guidance(UNKNOWN)
