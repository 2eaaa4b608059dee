"""Owns what is taken from each frame for the judges while the next ones are being recorded.

After the last frame somebody waits, before it nobody does. So whatever a judge needs of single frames, or of one direction alone, is
read as soon as it is there; what is left for afterwards is what needs both directions or the coordinates. There is no other way: a
stored sequence is pushed frame by frame as well. A gatherer serves one sequence and is dropped with it, so that nothing of a scan that
was cut off can come into the next one's verdicts.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from appliance.measure.decode.decoder import CameraDecoder
from appliance.measure.light.noise import CameraNoise
from appliance.measure.light.sequence import Direction, PatternSequence
from appliance.measure.points.grid import PixelGrid
from appliance.measure.verdicts.identity.lines import Lines, LineTaker
from appliance.measure.verdicts.light.changes import EarlyFit, fit_early
from appliance.measure.verdicts.light.levels import Sample, Sampler
from appliance.measure.verdicts.motion.cells import RunSums, run_sums
from appliance.measure.verdicts.motion.texture import Averager, Means
from appliance.measure.verdicts.sight.judge import VisibleFringes, see
from appliance.measure.verdicts.water.backscatter import water_grid
from appliance.measure.verdicts.window import window_grid


@dataclass(frozen=True, slots=True)
class Gathered:
    """Evidence that one camera's whole sequence left for its judges."""

    lines: Mapping[Direction, Lines]
    """Samples for the identity of the patterns, by direction."""
    sample: Sample
    """Pixels for the judge of light."""
    light: EarlyFit
    """Fit of X to the same pixels, for the same."""
    visible: VisibleFringes
    """Fringes that are seen without decoding."""
    means: Means
    """Images of texture for the judge of motion."""
    runs: RunSums
    """Sums of pixels of the sine images of X, for the same."""
    water: PixelGrid
    """Pixels for the judge of water."""
    windows: PixelGrid
    """Pixels for the judge of windows."""


class Gatherer:
    """Gathers one sequence of one camera, whose grey values scatter by ``noise`` and whose frames ``decoded`` decodes."""

    def __init__(self, sequence: PatternSequence, noise: CameraNoise, decoded: CameraDecoder) -> None:
        self._sequence, self._noise, self._decoded = sequence, noise, decoded
        self._lines = LineTaker(sequence, noise)
        self._sampler = Sampler(sequence)
        self._averager = Averager(sequence)
        self._grids = (water_grid(sequence), window_grid(sequence))
        self._of_x: tuple[EarlyFit, VisibleFringes, RunSums] | None = None
        self._pushed = 0

    def push(self, frames: NDArray[np.uint8], index: int) -> None:
        """Take what is wanted of frame ``index`` of ``frames`` (n, h, w) uint8, once it is decoded; in order, from 0."""
        self._pushed = index + 1
        self._lines.push(frames, index)
        self._sampler.push(frames, index)
        self._averager.push(frames, index)
        for grid in self._grids:
            grid.push(frames, index)
        if index == self._sequence.axis(Direction.X).sine[-1]:
            variance_dn2 = self._noise.dark_variance_dn2, self._noise.dn_per_e
            self._of_x = (
                fit_early(self._sampler.grey, self._sequence),
                see(frames, self._sequence, self._noise),
                run_sums(frames, self._decoded.p_px, self._sequence, variance_dn2),
            )

    def finish(self) -> Gathered:
        """Return what was gathered, after the last frame. Raises ValueError where frames are missing."""
        if self._of_x is None or self._pushed != len(self._sequence):
            raise ValueError(
                f"{self._pushed} of {len(self._sequence)} frames were pushed; push all before asking for verdicts"
            )
        light, visible, runs = self._of_x
        return Gathered(
            self._lines.finish(), self._sampler.finish(), light, visible, self._averager.finish(), runs, *self._grids
        )  # fmt: skip


def gather(
    frames: NDArray[np.uint8], sequence: PatternSequence, noise: CameraNoise, decoded: CameraDecoder
) -> Gathered:
    """Gather whole ``frames`` (n, h, w) uint8 of one camera, as they were ``decoded``."""
    gatherer = Gatherer(sequence, noise, decoded)
    for index in range(len(frames)):
        gatherer.push(frames, index)
    return gatherer.finish()
