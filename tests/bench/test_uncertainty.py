"""The judgement of sigma: of errors that are as expected it says so, and of others by how much they are not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from bench.verdict.uncertainty import OBJECTS, drawn, judged
from bench.verdict.uncertainty_picture import draw_uncertainty


def of(scale: float) -> tuple[dict[str, float], dict[str, Any]]:
    rng = np.random.default_rng(3)
    draws = [drawn(k, 7) for k in range(6)]
    sigmas = [rng.uniform(0.02, 0.3, 4000) for _ in draws]
    found, data = judged(draws, [scale * rng.standard_normal(4000) for _ in draws], sigmas)
    return {figure.name: figure.value for figure in found if not figure.kept}, data


def test_errors_as_expected_keep_every_bound_and_others_none() -> None:
    missed, data = of(1.0)
    assert not missed
    assert data["classes"]["all"]["rms"] == pytest.approx(1.0, abs=0.02)
    for one in data["reliability"]:
        assert one["rms_um"] == pytest.approx(one["expected_um"], rel=0.08)
    assert "error in sigmas: rms of all points" in of(1.3)[0]
    assert "within one sigma (normal: 0.683)" in of(0.7)[0]


def test_scans_differ_from_seed_to_seed_and_show_every_object() -> None:
    draws = [drawn(k, 1) for k in range(24)]
    assert {draw.scene.object for draw in draws} == set(OBJECTS)
    assert len({draw.scene.pose for draw in draws}) == 24
    assert drawn(3, 1) == drawn(3, 1) != drawn(3, 2)


def test_the_picture_shows_every_scan(tmp_path: Path) -> None:
    _, data = of(1.0)
    path = tmp_path / "uncertainty.png"
    draw_uncertainty(path, json.loads(json.dumps(data)))
    image = cv2.imread(str(path))
    assert image is not None
    assert np.count_nonzero(np.all(image == np.array((170, 120, 40)), axis=-1)) > 6 * 30
