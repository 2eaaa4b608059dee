"""Makes the images of a scan beforehand, so that two full-size cameras keep up with real time afterwards.

The service runs once in this process on the same world, in lock-step and without any node; the world keeps what it showed
(option ``stills``) and shows the same again to whoever lights and exposes the same.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from appliance.cli.simrig import SimOptions, apply_options, default_sim_rig
from appliance.instrument.service.app import run
from appliance.store.config import load_rig
from hw_sim.world import World

SCRIPT = """
wait state AIM 240
press back            # UNCALIBRATED: seen
pause 0.5
press scan
wait state REVIEW 240
pause 0.5
press back 1.0
wait state AIM 60
pause 0.5
end
"""


def rehearse(world: World, folder: Path) -> None:
    """One scan, thrown away. The world must stand under its name, in lock-step."""
    o = world.options
    folder.mkdir()
    script = folder / "rehearsal.script"
    script.write_text(SCRIPT, encoding="utf-8")
    size = f"{o.width_px}x{o.height_px}"
    rig = apply_options(load_rig(default_sim_rig()), SimOptions(root=folder / "root", size=size, script=script))
    options = {**rig.rig.wires_options, "world": o.world}
    board = replace(rig.board, url=f"kfsim://{o.world}/board")
    assert run(replace(rig, rig=replace(rig.rig, wires_options=options), board=board)) == 0
