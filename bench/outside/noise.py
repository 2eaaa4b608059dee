"""Camera noise as the instrument has it: from the data sheet, or measured by itself.

Measured as an owner does: one scan of an object with light and dark parts, in a dark tank, at rest, by the product's
photon transfer.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from appliance.calibrate.photon_transfer import measure_noise
from appliance.measure.light.exposure import Exposure
from appliance.measure.light.noise import StereoNoise, camera_noise
from appliance.measure.light.patterns import build_sequence
from appliance.measure.light.sides import SIDES
from bench.outside.kept import kept_row
from bench.outside.scan import data_sheet
from bench.outside.world import World, expose, world_with
from hw_sim.outside import Outside
from hw_sim.scene import Scene

PERIOD_PX = 64
EXPOSURE = Exposure(12_000)
TANK = Scene(object="plane", texture="strong", ambient=0.0)


def measured(world: World, gain_db: float, keep: Path | None) -> StereoNoise:
    """Return the noise at ``gain_db`` as the instrument measures it of its own cameras. Raises NoiseError."""
    cameras = world.scene.outside.cameras
    what = ("noise", world.rig.seed, world.rig.left.width_px, cameras)
    figures_of_sides = kept_row(keep, what, lambda: _figures(world))
    left, right = (
        (side_figures["full_well_e"], side_figures["read_noise_e"], side_figures["black_dn"])
        for side_figures in (figures_of_sides[side] for side in SIDES)
    )
    return StereoNoise(camera_noise(*left, gain_db), camera_noise(*right, gain_db))


def _figures(world: World) -> dict[str, dict[str, float]]:
    """Return full well and read noise in electrons, and the black level, of each camera."""
    outside = Outside(cameras=world.scene.outside.cameras)
    size_px = world.rig.left.width_px, world.rig.left.height_px
    tank = world_with(replace(TANK), outside, world.seed, ("cameras",), rig_seed=world.rig.seed, size_px=size_px)
    sequence = build_sequence(PERIOD_PX)
    frames = expose(tank.renderer(), sequence, EXPOSURE, number=3)
    figures_of_sides = {side: measure_noise(sequence, frames[side]).figures(side, EXPOSURE.gain_db) for side in SIDES}
    return {
        side: {
            "full_well_e": side_figures.full_well_e,
            "read_noise_e": side_figures.read_noise_e,
            "black_dn": side_figures.black_level_dn,
        }
        for side, side_figures in figures_of_sides.items()
    }


def from_data_sheet(world: World, gain_db: float, keep: Path | None) -> StereoNoise:
    """Return the noise as the data sheet of these very cameras says, entered into the rig file; ``keep`` is not used."""
    return data_sheet(world.scene, gain_db)


WAYS: MappingProxyType[str, Callable[[World, float, Path | None], StereoNoise]] = MappingProxyType(
    {"measured": measured, "sheet": from_data_sheet}
)
"""How the instrument comes to know its noise, by name."""
