"""Values of the rig file for the running instrument: machine settings, laser pointers, live light."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from appliance.instrument.capture.grabber import Timeouts
from appliance.instrument.machine.choices import Choices, offers_of
from appliance.instrument.machine.states import Settings, TemperatureLimits
from appliance.instrument.ranging.beams import Pointers
from appliance.instrument.ranging.expected_light import DrawnLight, live_light
from appliance.measure import PERIODS_PX, HousedCamera, Lens, Port, build_sequence
from appliance.store import Instrument, Rig


def pointers_of(rig: Rig) -> Pointers | None:
    """Return the nominal laser pointers; ``None``: there are none."""
    lasers = rig.lasers
    if lasers is None:
        return None
    window_mm = lasers.x_mm, lasers.y_mm, lasers.z_mm
    return Pointers(window_mm, (lasers.aim_x_mm, lasers.aim_y_mm, lasers.aim_z_mm), lasers.tolerance_deg)


def live_light_of(rig: Rig) -> NDArray[np.uint8]:
    """Return the projector's picture for the live views, (h, w) uint8."""
    return drawn_light_of(rig).codes


def drawn_light_of(rig: Rig) -> DrawnLight:
    """Return the light of the live views, with the nominal projector."""
    d, out = rig.design, rig.projector
    # Nominal, since the calibration has only the cameras; the dark lanes have a margin for that (ADR 0024).
    f_px = 1000.0 * d.projector_principal_distance_mm / d.projector_pixel_um
    lens = Lens((f_px, f_px), ((out.width_px - 1) / 2.0, (out.height_px - 1) / 2.0))
    port = Port((0.0, 0.0, 1.0), d.port_distance_mm, d.port_thickness_mm, d.port_index)
    projector = HousedCamera(out.width_px, out.height_px, lens, port)
    volume = Instrument(rig).volume
    return DrawnLight(projector, live_light(projector, pointers_of(rig), Instrument(rig).water.index, volume), volume)


def standard_choices(rig: Rig) -> Choices:
    """Return the rig file's values for the diver's choices."""
    water = rig.water
    return Choices(
        Instrument(rig).exposure, rig.scan.period_px, water.salinity_psu, water.temperature_c, rig.display.language
    )


def machine_settings(rig: Rig, choices: Choices | None = None) -> Settings:
    """Return the machine's settings by the rig file.

    ``choices``: the diver's earlier choices, if they are stored.
    """
    limits = rig.limits
    choices = standard_choices(rig) if choices is None else _allowed(rig, choices)
    width_px, height_px = rig.projector.width_px, rig.projector.height_px
    offered = [period_px for period_px in PERIODS_PX if period_px <= min(width_px, height_px)]
    sequences = {period_px: len(build_sequence(period_px, width_px, height_px)) for period_px in offered}
    return Settings(
        choices=choices,
        offers=offers_of(standard_choices(rig), Instrument(rig).exposures, tuple(sequences)),
        frames=sequences,
        refresh_hz=rig.projector.refresh_hz,
        capture_margin_s=Timeouts(rig.projector.refresh_hz).margin_s,
        temperatures={
            "case": TemperatureLimits(limits.case_warm_c, limits.case_hot_c, limits.case_off_c),
            "projector": TemperatureLimits(limits.projector_warm_c, limits.projector_hot_c, limits.projector_off_c),
        },
        supply_low_v=limits.supply_low_v,
        volume=Instrument(rig).volume,
    )


def _allowed(rig: Rig, choices: Choices) -> Choices:
    """Return earlier choices with the nearest exposure that this rig file allows."""
    if rig.scan.exposures_ms is None and rig.projector.sub_frames == 1:
        return choices
    steps = [Instrument(rig).exposure, *Instrument(rig).exposures]
    chosen = choices.exposure
    if chosen.time_us in {step.time_us for step in steps}:
        return choices
    return replace(choices, exposure=min(steps, key=lambda step: abs(math.log(step.light / chosen.light))))
