"""Patterns drawn for a response are a sine of light; nothing else of them changes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import chebyshev

from appliance.patterns.response import Response, phase_error_rad
from appliance.patterns.sequence import Kind, build_sequence

X = np.linspace(-1.0, 1.0, 2001)


def light_of(codes: np.ndarray) -> np.ndarray:
    """A projector with toe and shoulder, by a formula of its own."""
    x = codes.astype(float) / 255.0
    return 0.3 * x**1.2 + 0.7 * (3 * x**2 - 2 * x**3)


def response() -> Response:
    fitted = chebyshev.chebfit(X, light_of(127.5 + 119.5 * X), 12)
    return Response(tuple(float(b) for b in fitted))


def harmonic(light: np.ndarray, order: int) -> float:
    phase = 2 * np.pi * (np.arange(light.size) + 0.5) / 64
    return float(2 * np.mean(light * np.cos(order * phase)))


def test_light_is_a_sine_where_codes_were_one_before() -> None:
    sequence = build_sequence(64)
    sine = sequence.patterns[sequence.axis(sequence.patterns[-1].direction).sine[0]]
    before, after = light_of(sine.codes()), light_of(sine.codes(response()))
    for order in (2, 3):
        assert abs(harmonic(before, order)) > 0.01 or order == 2
        assert abs(harmonic(after, order)) < 0.002 * harmonic(after, 1)
    assert abs(harmonic(before, 3)) > 0.05 * harmonic(before, 1)
    assert after.max() == pytest.approx(before.max(), abs=0.005), "no contrast is given away"
    assert after.min() == pytest.approx(before.min(), abs=0.005)


def test_the_phase_error_of_harmonics_is_what_four_steps_make_of_them() -> None:
    b = (0.5, 0.45, 0.06, -0.03, 0.01, 0.008)
    phi = np.linspace(0, 2 * np.pi, 5000)
    i0, i1, i2, i3 = (sum(a * np.cos(k * (phi + step * np.pi / 2)) for k, a in enumerate(b)) for step in range(4))
    error = np.angle(np.exp(1j * (np.arctan2(i3 - i1, i0 - i2) - phi)))
    assert phase_error_rad(b) == pytest.approx(np.abs(error).max(), rel=1e-3)
    assert phase_error_rad((0.5, 0.45, 0.2, 0.0, 0.1)) < 1e-12, "even harmonics cancel"


def test_only_sine_images_change() -> None:
    for pattern in build_sequence(16).patterns:
        same = (pattern.codes() == pattern.codes(response())).all()
        assert same == (pattern.kind is not Kind.SINE), pattern.name


@pytest.mark.parametrize("harmonics", [(0.5,), (0.5, -0.5), (0.5, 0.5, 0.5), (0.5, float("nan")), (0.1,) * 30])
def test_what_no_projector_does_is_refused(harmonics: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="measure it again"):
        Response(harmonics)
