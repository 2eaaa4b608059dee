"""A dive on the simulated instrument: a spoilt scan is refused by name, the next one is kept, and it lies on the pipe."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from appliance.calibration.file import encode
from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import load_rig
from appliance.instrument import CALIBRATION_FILE
from appliance.service.app import run
from appliance.storage.library import Library
from hw_sim.options import options_from
from hw_sim.rendering.render import Renderer
from hw_sim.truth import draw_truth
from tests.support.truth import left_to_rig, true_calibration

DIVE = """
wait state AIM 90
pause 0.5
fault camera.left intermittent frame=9
press scan
wait alert FRAME_MISSING 30
clear
press scan
wait state REVIEW 60
pause 1
press scan
wait state AIM 60
pause 0.5
end
"""


def test_a_dive(tmp_path: Path) -> None:
    script = tmp_path / "dive.script"
    script.write_text(DIVE)
    options = SimOptions(
        root=tmp_path / "dive", object_name="pipe", truth="modelled", seed=11, size="400x300", script=script
    )
    rig = simulated(load_rig(default_sim_rig()), options)
    world = options_from(rig.rig.wires_options)
    truth = draw_truth(world.truth, world.seed, world.width_px, world.height_px, world.scene().water.index)
    calibration = rig.storage.root / CALIBRATION_FILE
    calibration.parent.mkdir(parents=True)
    calibration.write_bytes(encode(true_calibration(truth, rig.rig.serial)))

    assert run(rig) == 0

    library = Library(rig.storage.root)
    assert [entry.ok for entry in library.entries()] == [True]
    last = library.last_id()
    assert last is not None
    assert library.verify(last).ok, "every checksum fits"
    scan = library.load(last)
    cloud = scan.cloud()
    assert cloud is not None
    surface = Renderer(truth, world.scene()).surface(0.0)
    distance = surface.distance_mm(left_to_rig(truth, cloud.points_mm))
    assert len(distance) > 40_000
    assert np.sqrt(np.mean(distance**2)) < 0.06
    assert scan.manifest.record.verdicts[0].passed is True
    assert set(scan.manifest.record.stage_times_s) >= {"recording", "coarse", "full", "saved"}
