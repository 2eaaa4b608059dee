"""A camera that bends grey is told by the other one; light, paint, noise and the projector's own response are nobody's gamma."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.measure.fault import FaultCode
from appliance.measure.light.patterns import Direction, build_sequence
from appliance.measure.verdict import Judgement
from appliance.measure.verdicts.grey import judge_grey
from appliance.measure.verdicts.light.levels import sample
from tests.support.golden_texts import Says
from tests.support.synthetic import frames as ideal_frames

SEQUENCE = build_sequence(16, 128, 96)
SIZE_PX = (96, 128)
Curve = Callable[[NDArray[np.float64]], NDArray[np.float64]]


def straight(share: NDArray[np.float64]) -> NDArray[np.float64]:
    return share


def power(exponent: float) -> Curve:
    return lambda share: share**exponent


def recorded(
    seed: int, *, camera: Curve = straight, lamp: Curve = straight, light: float = 0.8, ambient: float = 0.03
) -> NDArray[np.uint8]:
    """Frames before paint from 0.4 to 1, as a camera with that curve records them; ``light``: white's share of the full scale."""
    v, u = np.mgrid[0.0 : SIZE_PX[0], 0.0 : SIZE_PX[1]]
    codes = ideal_frames(SEQUENCE, np.stack([0.9 * u + 3.0, 0.9 * v + 2.0], -1)) / 255.0
    paint = 0.7 + 0.3 * np.sin(u / 9.0) * np.cos(v / 7.0)
    seen = camera(np.clip((light * lamp(np.clip(codes, 0.0, 1.0)) + ambient) * paint, 0.0, 1.0))
    noise = np.random.default_rng(seed).standard_normal(seen.shape) * 1.2
    return np.clip(np.rint(255.0 * seen + noise), 0, 255).astype(np.uint8)


def judged(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Judgement:
    return judge_grey({"left": sample(left, SEQUENCE), "right": sample(right, SEQUENCE)}, SEQUENCE)


@pytest.mark.parametrize(("exponent", "side"), [(0.45, "left"), (0.8, "right")])
def test_a_gamma_in_one_camera_is_named_with_the_camera_and_what_to_set(exponent: float, side: str, says: Says) -> None:
    frames = {one: recorded(k, camera=power(exponent) if one == side else straight) for k, one in enumerate(("left", "right"))}  # fmt: skip
    found = judged(**frames)
    assert found.verdict.passed is False
    assert found.fault is not None
    assert (found.fault.code, found.fault.device) == (FaultCode.GREY_BENT, f"camera.{side}")
    says(found.fault.detail)


@pytest.mark.parametrize(
    "lamp",
    [power(2.2), power(0.6), lambda share: 0.5 * share + 0.5 * (share > 0.5)],
    ids=["gamma 2.2", "gamma 0.6", "a cut bit plane"],
)
def test_whatever_the_projector_makes_of_a_code_is_no_cameras_doing(lamp: Curve) -> None:
    found = judged(recorded(1, lamp=lamp), recorded(2, lamp=lamp, light=0.5, ambient=0.2))
    assert found.verdict.passed is True, found.verdict
    assert found.fault is None


def test_a_sensor_that_bends_by_two_percent_is_none() -> None:
    """At half of the full well, as data sheets say; and the other camera sees things half as bright."""
    left, right = (recorded(k, camera=lambda s: s + 4.0 * 0.02 * s * (1.0 - s), light=0.8 / k) for k in (1, 2))
    assert judged(left, right).verdict.passed is True


def test_nothing_is_said_of_what_is_too_dark_or_saturated_or_changes_from_one_direction_to_the_other() -> None:
    dimmed = recorded(1).astype(np.float64)
    dimmed[list(SEQUENCE.axis(Direction.Y).sine)] *= 0.8
    for left in (recorded(1, light=0.1), recorded(1, light=4.0), np.rint(dimmed).astype(np.uint8)):
        found = judged(left, recorded(2))
        assert (found.verdict.passed, found.fault) == (None, None)
