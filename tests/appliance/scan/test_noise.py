"""Grey values scatter as a data sheet after EMVA 1288 says, one by one and in whole images."""

from __future__ import annotations

import numpy as np
import pytest

from appliance.scan.noise import CameraNoise

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
