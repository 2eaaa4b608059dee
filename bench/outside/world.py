"""One scene of the world ``outside``: its families, the true rig, and how its frames are rendered.

Every part of this measurement begins here, so that each sees the same world: the rig is drawn for the index of the scene's
water at the LED's own colour, has windows of that colour, and is as warm as stated; frames begin as long after the vertical
blank as the instrument's trigger delay says.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.measure.light.exposure import Exposure, Span, ladder
from appliance.measure.light.patterns import PatternSequence
from appliance.measure.light.response import Response
from appliance.measure.light.sides import SIDES
from appliance.measure.verdicts.light.judge import propose
from hw_sim.in_dive import REFERENCE_C, in_dive
from hw_sim.outside import ALL, Outside, draw_outside
from hw_sim.rendering.render import LightSlice, Renderer
from hw_sim.scene import Scene
from hw_sim.truth import TrueRig, draw_truth, with_flaws, with_glass
from tests.support.rendered import pictures

SMALL_PX = 400, 300
"""Width and height of the images that most parts are measured with."""
FRAME_S = 1.0 / 60.0
TRIGGER_DELAY_US = 500
"""Of the instrument's rig file, ``[board] trigger_delay_us``."""
STEPS = ladder(60.0, TRIGGER_DELAY_US, 0.0, Span())
"""Exposures that the instrument may choose from."""
USUAL = Exposure(12_000)
TOP_PERCENT = 99.7
"""Percentile of the bright frame that an exposure is chosen by."""
FULL_DN, SATURATED_DN, BLACK_DN = 255.0, 254.5, 2.0
LATENCY = 4.0
"""Delay of a camera after the pulse, in its jitters."""
Frames = dict[str, NDArray[np.uint8]]


@dataclass(frozen=True, slots=True)
class World:
    """A scene with its families, and the true rig before it."""

    seed: int
    families: tuple[str, ...]
    scene: Scene
    rig: TrueRig

    def renderer(self) -> Renderer:
        """Return the renderer of its frames."""
        return Renderer(self.rig, self.scene)


def world_of(
    scene: Scene,
    seed: int,
    families: Sequence[str] = ALL,
    *,
    rig_seed: int | None = None,
    truth_set: str = "realistic",
    size_px: tuple[int, int] = SMALL_PX,
    case_c: float = REFERENCE_C,
) -> World:
    """Return ``scene`` with the ``families`` drawn by ``seed``, and the rig that stands before it with its case at ``case_c``.

    ``rig_seed``: the hidden rig's own, by default ``seed``; of two worlds with the same rig seed, set and families of lens and
    plates the instrument is the same only if their ``seed`` is, too: the strengths of lens and plates are drawn by ``seed``, as the
    world option does. Raises ValueError for an unknown family or set.
    """
    return world_with(
        scene, draw_outside(seed, families), seed, families,
        rig_seed=rig_seed, truth_set=truth_set, size_px=size_px, case_c=case_c,
    )  # fmt: skip


def world_with(
    scene: Scene,
    outside: Outside,
    seed: int,
    families: Sequence[str],
    *,
    rig_seed: int | None = None,
    truth_set: str = "realistic",
    size_px: tuple[int, int] = SMALL_PX,
    case_c: float = REFERENCE_C,
) -> World:
    """Return a world as ``world_of`` does, with given strengths of the families.

    For instance, those of an instrument that stays the same over many scenes.
    """
    scene = replace(scene, outside=outside)
    rig = draw_truth(truth_set, seed if rig_seed is None else rig_seed, *size_px, scene.index)
    # Here the world option's seed is the rig's as well: fields are drawn by the rig's seed, strengths by the world's.
    rig = with_glass(with_flaws(rig, outside), scene.glass_more)
    if outside.mounts is not None:
        rig = in_dive(rig, outside.mounts, case_c - REFERENCE_C)
    return World(seed, tuple(families), scene, rig)


def expose(
    renderer: Renderer,
    sequence: PatternSequence,
    exposure: Exposure,
    *,
    number: int = 0,
    response: Response | None = None,
    only: Sequence[int] | None = None,
    sides: Sequence[str] = SIDES,
    trigger_delay_us: int = TRIGGER_DELAY_US,
) -> Frames:
    """Return the frames (n, h, w) uint8 of the ``sides`` that the instrument records of a sequence, hands moving from its first pulse on.

    ``number``: of the sequence, which other noise, other flashes and another jitter belong to. ``only``: indices of the patterns
    that are wanted. ``response``: the projector's, that the patterns are drawn for.
    """
    shown = list(enumerate(pictures(sequence, response)))
    if only is not None:
        shown = [shown[k] for k in only]
    exposure_s = exposure.time_us / 1e6
    seed = 1_000_000 * (number + 1)
    begins_s = _begins(renderer, len(sequence), number, trigger_delay_us)

    def camera(side: str) -> NDArray[np.uint8]:
        shots = []
        for k, picture in shown:
            light = [LightSlice(picture, exposure_s, begins_s[side][k], FRAME_S)]
            middle_s = k * FRAME_S + 0.5 * exposure_s
            # Sequences are an odd number of frames apart, by the clock that flashes and daylight go by.
            clock_s = middle_s + 997 * FRAME_S * number
            shots.append(
                renderer.expose(
                    side,
                    light,
                    middle_s,
                    exposure_s,
                    exposure.gain_db,
                    (False, False),
                    seed + 2 * k + (side == "left"),
                    clock_s,
                )
            )
        return np.stack(shots)

    with ThreadPoolExecutor(1) as pool:
        return dict(zip(sides, pool.map(camera, sides), strict=True))


def _begins(renderer: Renderer, count: int, number: int, trigger_delay_us: int) -> dict[str, NDArray[np.float64]]:
    """Return for each side how long after its vertical blank each exposure begins, seconds (count,)."""
    delay_s = np.full(count, trigger_delay_us / 1e6)
    clocks = renderer.scene.outside.clocks
    if clocks is None:
        return dict.fromkeys(SIDES, delay_s)
    rng = np.random.default_rng([renderer.truth.seed, number, 7])
    # The pulse is common to both cameras; each then begins by itself.
    pulse_s = delay_s + 1e-6 * clocks.board_jitter_us * rng.standard_normal(count)
    own_s = 1e-6 * clocks.camera_jitter_us
    return {side: pulse_s + np.maximum(own_s * (LATENCY + rng.standard_normal(count)), 0.0) for side in SIDES}


def chosen_exposure(
    renderer: Renderer, sequence: PatternSequence, steps: Sequence[Exposure] = STEPS, first: Exposure = USUAL
) -> Exposure:
    """Return the exposure that the instrument's proposals lead to, from ``first`` on, within ``steps``."""
    present = first
    for _ in range(4):
        # The left camera tells it: what the right one sees is as bright but for where gloss is.
        (shot,) = expose(renderer, sequence, present, only=[sequence.bright], number=77, sides=("left",))["left"]
        top_dn = float(np.percentile(shot, TOP_PERCENT))
        # Saturated: the instrument reads the level from the darkest sine images; here a much shorter exposure tells it.
        blind = top_dn >= SATURATED_DN and present != steps[0]
        proposed = steps[0] if blind else propose(top_dn - BLACK_DN, FULL_DN - BLACK_DN, present, steps)
        if proposed is None:
            break
        present = proposed
    return present
