"""Owns what the instrument is told about its cameras' noise: the data sheet of these very cameras."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import MappingProxyType

from appliance.scan.noise import StereoNoise
from bench.outside.scan import data_sheet
from bench.outside.world import World


def from_data_sheet(world: World, gain_db: float, keep: Path | None) -> StereoNoise:
    """Return the noise as the data sheet of these very cameras says, entered into the rig file; ``keep`` is not used."""
    return data_sheet(world.scene, gain_db)


WAYS: MappingProxyType[str, Callable[[World, float, Path | None], StereoNoise]] = MappingProxyType(
    {"sheet": from_data_sheet}
)
"""How the instrument comes to know its noise, by name."""
