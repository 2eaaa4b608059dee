"""A field that no correction can follow, seen in water only: whoever calibrates reads what lengths are worth, and what to do."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.calibration.water.calibrate import calibrate
from appliance.calibration.water.expected import FLAT_PERCENT, LENGTH_PERCENT
from appliance.calibration.water.method import Method
from appliance.calibration.water.report import as_html, as_json
from appliance.cli import calibrate as verb
from hw_sim.truth import TrueRig, project
from tests.support import calibrating
from tests.support.calibrating import Errors

pytestmark = pytest.mark.dive

AMPLITUDE_PX, PERIOD_PX = 0.25, 90.0
"""Of ripples on both windows: the correction's intervals are 100 px wide."""


def rippled(truth: TrueRig, side: str, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return where the points are seen through windows with ripples, other ones for each camera."""
    uv = np.asarray(project(truth, side, points))
    phase = 0.7 if side == "left" else 2.1
    x, y = 2.0 * np.pi * uv[..., 0] / PERIOD_PX + phase, 2.0 * np.pi * uv[..., 1] / PERIOD_PX - phase
    return uv + AMPLITUDE_PX * np.stack([np.sin(x) * np.cos(y), np.cos(x + 1.0) * np.sin(y)], -1)


@dataclass(frozen=True)
class Case:
    content: dict[str, Any]
    html: str
    errors: Errors


def calibrated(see: Callable[..., NDArray[np.float64]]) -> Case:
    """Return a calibration of four recordings that were made through the windows that ``see`` is of; in air there were none."""
    truth = calibrating.hidden_rig("modelled", 10_004)
    start = calibrating.start_of(calibrating.air_of(truth))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibrating, "project", see)
        result = calibrate(Method.SPLINE, calibrating.calibration_recordings(truth), start)
        errors = calibrating.evaluate(truth, result.calibration.rig, planes=1)
    return Case(as_json(result, start, {}, {}), as_html(result, start, {}, {}), errors)


def test_a_field_that_the_correction_cannot_follow_is_announced_to_who_calibrates(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    case = calibrated(rippled)
    assert max(case.errors.length / LENGTH_PERCENT, case.errors.flatness / FLAT_PERCENT) > 1.0, "it does no harm"
    (said,) = [one for one in case.content["warnings"] if one.startswith("lengths may be wrong by")]
    assert "are left that the model does not explain" in said
    assert 0.5 < case.content["expected_length_percent"] / case.errors.length < 3.0
    assert 0.5 < case.content["expected_flat_percent"] / case.errors.flatness < 3.0
    assert "lengths may be wrong by" in case.html
    verb._tell(case.content, tmp_path / "report.html", Path("water.json"))
    assert f"warning: {said}\n" in capsys.readouterr().out
