"""The step ``latency``: the number of vertical blanks from a picture's flip to its light."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from appliance.workshop.bench import Bench, Shot, flat_pictures, lit_part, mean_levels
from appliance.workshop.finding import BringupError, finding_of
from appliance.workshop.light import MOST_US
from appliance.workshop.step import StepOutcome

FLASH_FRAMES = 24
FLASH_DELAY_US = 500
MOST_LATENCY_BLANKS = 5
FLASH_SHARE = 0.03
"""Share of a flash's light from which a frame counts as lit by it."""
FLASH_DN = 3.0
"""Light below which there is no flash at all."""


def measure_latency(bench: Bench) -> tuple[int, dict[str, NDArray[np.bool_]]]:
    """Return the latency in blanks, and the pixels of each camera's images that the projector lights.

    Raises BringupError where the cameras disagree.
    """
    bench.load(flat_pictures(bench.size_px, (255, 0)), all_channels=False)
    exposure_us = int(min(MOST_US, 0.92e6 / bench.refresh_hz) - FLASH_DELAY_US)
    frames = bench.take([0] + [1] * (FLASH_FRAMES - 1), Shot(FLASH_DELAY_US, exposure_us))
    latencies, parts = {}, {}
    for side, images in frames.items():
        part = lit_part(images.max(axis=0), images.min(axis=0), max_dn=256.0)
        if not part.any():
            part = np.ones(images.shape[1:], np.bool_)
        latencies[side], parts[side] = latency_of(mean_levels(images, part)), part
    # The projector has one latency: where cameras disagree, one of them missed the first trigger.
    if len(set(latencies.values())) > 1:
        raise BringupError(
            f"the cameras see the light {' and '.join(f'{blanks} blanks ({side})' for side, blanks in latencies.items())} "
            "after the flip: one of "
            "them misses the first trigger; check its line and its trigger's overlap"
        )
    return next(iter(latencies.values())), parts


def latency_of(levels: NDArray[np.float64]) -> int:
    """Return the first frame that a single white picture lights, in vertical blanks after its flip.

    ``levels`` (n,) are the mean grey values of n exposures, each nearly a whole frame, the first at the picture's own
    blank. Raises BringupError where no frame, or every frame, is lit, or the light comes later than a rig file allows.
    """
    dark = float(np.median(levels))
    light = levels - dark
    total = float(light[light > 0.0].sum())
    if light.max() < FLASH_DN:
        raise BringupError(
            f"one white picture among black ones changed the images by {light.max():.1f} grey values; {FLASH_DN:g} are "
            "needed: check "
            "that the projector lights what the cameras see, its focus and its cable, and darken the room"
        )
    # Relative to all light, not to the brightest frame: light that begins in mid-frame is spread over two frames.
    lit_frames = np.flatnonzero(light > max(FLASH_SHARE * total, 0.5 * FLASH_DN))
    first, last = int(lit_frames[0]), int(lit_frames[-1])
    if last - first > 2:
        raise BringupError(
            f"one white picture lit {last - first + 1} frames in a row; allowed are 2: switch frame interpolation and "
            "motion smoothing off"
        )
    if first > MOST_LATENCY_BLANKS:
        raise BringupError(
            f"a picture's light came {first} vertical blanks after its flip; allowed are 0..{MOST_LATENCY_BLANKS}: "
            "switch the projector's "
            "picture processing off (game mode, direct mode)"
        )
    return first


def judge(blanks: int) -> StepOutcome:
    """Return the finding about the latency, which is good: a bad one has ended the measurement."""
    statement = f"a picture's light comes {blanks} vertical blank{'' if blanks == 1 else 's'} after its flip"
    return StepOutcome(
        (finding_of("latency", True, statement, f"0..{MOST_LATENCY_BLANKS} blanks", "", latency_blanks=blanks),)
    )
