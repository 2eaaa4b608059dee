"""A foreign set of our own form becomes a scan folder that everything else accepts; any other one is refused with the reason."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from appliance.cli.output import Exit
from appliance.storage.ply import read_ply
from tests.support.commands import Shell
from tests.support.foreign_sets import ForeignSet
from tests.support.truth import left_to_rig

Sets = Callable[[str], ForeignSet]


@pytest.mark.dive
def test_two_directions_of_four_steps_become_a_scan_folder(shell: Shell, foreign_set: Sets, tmp_path: Path) -> None:
    made = foreign_set("two-directions")
    said = shell("import", made.description, "--out", tmp_path / "000001", "--json")
    assert (said.code, said.err) == (Exit.OK, "")
    assert (said.document["frames"], said.document["period_px"]) == (22, 32)
    # The instrument's own reconstruction, with its own four-step kernels, of the images in its own order.
    own = shell("reconstruct", tmp_path / "000001", "--out", tmp_path / "own.ply", "--json")
    assert own.code == Exit.OK, own.err
    points_mm = read_ply(tmp_path / "own.ply").points_mm
    distance = made.renderer.surface(0.0).distance_mm(left_to_rig(made.renderer.truth, points_mm))
    assert float(np.median(np.abs(distance))) < 0.08
    # The general decoder has found nearly the same pixels.
    assert abs(own.document["points"] / said.document["points"] - 1.0) < 0.02
    again = shell("import", made.description, "--out", tmp_path / "000001")
    assert again.code == Exit.FAILED
    assert "is there already" in again.error


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("three-steps", "fringes of one direction only"),
        ("half-off", "fringes of one direction only"),
        ("inverses", "it has no bright and dark image"),
    ],
)
def test_another_form_is_no_scan_folder(
    shell: Shell, foreign_set: Sets, tmp_path: Path, name: str, reason: str
) -> None:
    said = shell("import", foreign_set(name).description, "--out", tmp_path / "000001")
    assert said.code == Exit.FAILED
    assert reason in said.error
    assert not (tmp_path / "000001").exists()
