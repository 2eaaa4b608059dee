"""Grey values scatter as a data sheet after EMVA 1288 says, one by one and in whole images."""

from __future__ import annotations

import math
from statistics import NormalDist

import numpy as np
import pytest

from appliance.config.load import default_rig_path, load_rig
from appliance.scan.noise import MAD_TO_SIGMA, TYPICAL, CameraNoise, camera_noise

CAMERA = CameraNoise(read_dn=0.9, dn_per_e=0.05, black_dn=3.0)


def test_an_image_scatters_as_each_of_its_grey_values() -> None:
    grey_dn = np.array([[0.0, 3.0], [4.0, 255.0]])
    variance = CAMERA.variance_dn2(grey_dn)
    assert variance.tolist() == [[CAMERA.variance_dn2(float(v)) for v in row] for row in grey_dn]
    assert variance[0, 0] == variance[0, 1] == pytest.approx(0.81), "below black there is no light to be missing"
    assert variance[1, 1] == pytest.approx(0.81 + 0.05 * 252.0)


def test_an_image_keeps_its_type() -> None:
    assert CAMERA.variance_dn2(np.zeros(3, np.float32)).dtype == np.float32
    assert CAMERA.variance_dn2(np.zeros(3)).dtype == np.float64


def test_what_kernels_add_light_to_gives_the_same_line() -> None:
    assert CAMERA.dark_variance_dn2 + 0.05 * 200.0 == pytest.approx(CAMERA.variance_dn2(200.0))


def test_a_full_well_of_electrons_scatters_by_its_root() -> None:
    """EMVA 1288: of 10,000 electrons 100 are noise, one part in a hundred of the saturated grey value."""
    camera = camera_noise(full_well_e=10_000.0, read_noise_e=0.0, black_dn=0.0, gain_db=0.0)
    photons_dn = math.sqrt(camera.variance_dn2(255.0) - camera.variance_dn2(0.0))
    assert photons_dn == pytest.approx(2.55)
    assert camera.variance_dn2(0.0) == pytest.approx(1.0 / 12.0), "what is left is rounding to whole grey values"


def test_the_read_noise_of_the_data_sheet_is_that_of_a_dark_image() -> None:
    """20 of 10,000 electrons are 0.51 of 255 grey values; at twice the gain they are twice as many."""
    for gain_db, factor in ((0.0, 1.0), (20.0 * math.log10(2.0), 2.0), (20.0, 10.0)):
        camera = camera_noise(full_well_e=10_000.0, read_noise_e=20.0, black_dn=4.0, gain_db=gain_db)
        assert camera.black_dn == 4.0
        assert camera.variance_dn2(4.0) == pytest.approx((0.51 * factor) ** 2 + 1.0 / 12.0)
        assert camera.dn_per_e == pytest.approx(0.0255 * factor)


def test_a_camera_of_which_nothing_is_known_is_taken_for_the_one_of_the_rig_file_that_is_shipped() -> None:
    camera = load_rig(default_rig_path()).camera.left
    assert camera_noise(camera.full_well_e, camera.read_noise_e, camera.black_level_dn, 0.0) == TYPICAL


def test_the_median_of_the_distances_from_the_mean_tells_the_standard_deviation() -> None:
    assert MAD_TO_SIGMA * NormalDist().inv_cdf(0.75) == pytest.approx(1.0, abs=1e-4)
