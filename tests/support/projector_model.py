"""A projector and two cameras in a few lines of arithmetic: bit planes on a time axis, summed over each exposure.

It shares nothing with the measurement but the protocol of its bench. Bit planes are stretches (begin, end) of a frame in µs, by bit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from appliance.workshop.bench import Image, Shot

PERIOD_US = 1e6 / 60.0
FINE = 4
"""Parts of a camera's pixel, each way, that a picture is sampled in."""
Stretch = tuple[float, float]


def planes_in(
    begin_us: float, end_us: float, order: Sequence[int] = (7, 3, 5, 0, 6, 1, 4, 2)
) -> dict[int, list[Stretch]]:
    """Eight binary-weighted planes one after the other in ``order``, filling a window."""
    at, unit = begin_us, (end_us - begin_us) / 255.0
    planes: dict[int, list[Stretch]] = {}
    for bit in order:
        planes[bit] = [(at, at + unit * 2**bit)]
        at += unit * 2**bit
    return planes


def steady(begin_us: float = 0.0, end_us: float = PERIOD_US, cycles: int = 400) -> dict[int, list[Stretch]]:
    """A light so fast that every slice sees all of its planes."""
    length = (end_us - begin_us) / cycles
    return joined(*(planes_in(begin_us + k * length, begin_us + (k + 1) * length) for k in range(cycles)))


def joined(*parts: Mapping[int, list[Stretch]]) -> dict[int, list[Stretch]]:
    return {bit: [one for part in parts for one in part[bit]] for bit in range(8)}


@dataclass(frozen=True)
class Model:
    """What is built."""

    green: Mapping[int, list[Stretch]]
    others: Mapping[int, list[Stretch]] | None = None
    """Planes of red and blue."""
    latency: int = 0
    lag_us: float = 0.0
    gamma: float = 1.0
    scale: float = 1.0
    mirrored: bool = False
    upside_down: bool = False
    exchanged: bool = False
    late_us: Mapping[str, float] = field(default_factory=dict)
    """By camera: how late it exposes."""
    white_dn_per_ms: float = 14.0
    noise_dn: float = 0.5
    unrest: float = 0.0
    """Standard deviation of a frame's brightness."""


@dataclass
class ModelBench:
    """``appliance.workshop.bench.Bench`` on a ``Model``."""

    model: Model
    size_px: tuple[int, int] = (64, 48)
    camera_px: tuple[int, int] = (40, 30)
    refresh_hz: float = 60.0
    takes: int = 0

    def load(self, pictures: Sequence[Image], *, all_channels: bool) -> None:
        self._all = all_channels
        black = np.zeros(self.size_px[::-1], np.uint8)
        self._pictures = [*pictures, black]
        self._planes = {side: [self._seen(p, side) for p in self._pictures] for side in ("left", "right")}

    def take(self, order: Sequence[int], shot: Shot) -> Mapping[str, Image]:
        self.takes += 1
        rng = np.random.default_rng(self.takes)
        shown = [len(self._pictures) - 1, *order]
        found = {}
        for side in ("left", "right"):
            width, height = self.camera_px
            frames = np.empty((len(order), height, width))
            begins = shot.delay_us + self.model.late_us.get(side, 0.0) + shot.blanks * PERIOD_US
            weights = {}
            for away in range(-7, shot.blanks + 2):
                # A picture lights from its blank on, later by latency and lag, for a period.
                start = (away + self.model.latency) * PERIOD_US + self.model.lag_us
                found_weights = self._weights(begins - start, begins - start + shot.exposure_us)
                if found_weights.any():
                    weights[away] = found_weights
            for k in range(len(order)):
                light = np.zeros((height, width))
                for away, by_bit in weights.items():
                    place = k + away + 1
                    picture = shown[place] if 0 <= place < len(shown) else len(self._pictures) - 1
                    light += np.tensordot(by_bit, self._planes[side][picture], 1)
                gain = 10.0 ** (shot.gain_db / 20.0) * (1.0 + self.model.unrest * rng.standard_normal())
                frames[k] = 2.0 + gain * self.model.white_dn_per_ms * light
            frames += self.model.noise_dn * rng.standard_normal(frames.shape)
            found[side] = np.clip(np.rint(frames), 0, 255).astype(np.uint8)
        return found

    def _weights(self, begin: float, end: float) -> NDArray[np.float64]:
        """ms of each bit's light in an exposure from ``begin`` to ``end`` after a picture's begin."""
        weights = np.zeros(8)
        if begin >= PERIOD_US or end <= 0.0:
            return weights
        sets = [self.model.green] + ([self.model.others] if self._all and self.model.others is not None else [])
        for planes in sets:
            for bit, stretches in planes.items():
                edges = np.asarray(stretches)
                weights[bit] += (
                    np.clip(np.minimum(edges[:, 1], end) - np.maximum(edges[:, 0], begin), 0.0, None).sum() / 1000.0
                )
        return weights

    def _seen(self, picture: Image, side: str) -> NDArray[np.float32]:
        """Bit planes of a picture as a camera sees them, (8, h, w)."""
        drawn = np.rint(255.0 * (picture / 255.0) ** self.model.gamma).astype(np.uint8)
        width, height = self.camera_px
        if drawn.min() == drawn.max():
            bits = [(int(drawn.flat[0]) >> bit) & 1 for bit in range(8)]
            return np.multiply.outer(np.array(bits, np.float32), np.ones((height, width), np.float32))
        if self.model.scale != 1.0:
            h, w = drawn.shape
            size = (round(w * self.model.scale), round(h * self.model.scale))
            drawn = np.asarray(cv2.resize(drawn, size, interpolation=cv2.INTER_NEAREST), np.uint8)
        drawn = drawn[:, ::-1] if self.model.mirrored else drawn
        drawn = drawn[::-1] if self.model.upside_down else drawn
        planes = np.stack([(drawn >> bit) & 1 for bit in range(8)]).astype(np.float32)
        fine = [
            cv2.resize(
                np.ascontiguousarray(p),
                (FINE * width, FINE * height),
                interpolation=cv2.INTER_AREA if p.shape[1] > FINE * width else cv2.INTER_NEAREST,
            )
            for p in planes
        ]
        u = (np.arange(FINE * width) + 0.5) / (FINE * width) * 2.0 - 1.0
        # The nearer side is larger: on the left of the left camera.
        bend = 0.05 if (side == "left") != self.model.exchanged else -0.05
        source = (u + bend * (u**2 - 1.0) + 1.0) / 2.0 * FINE * width - 0.5
        across = np.broadcast_to(source.astype(np.float32), (FINE * height, FINE * width))
        down = np.broadcast_to(np.arange(FINE * height, dtype=np.float32)[:, None], across.shape)
        moved = [cv2.remap(p, np.ascontiguousarray(across), np.ascontiguousarray(down), cv2.INTER_LINEAR) for p in fine]
        small = [cv2.resize(p, (width, height), interpolation=cv2.INTER_AREA) for p in moved]
        return np.stack(small).astype(np.float32)


def but(model: Model, **changes: object) -> Model:
    return replace(model, **changes)  # type: ignore[arg-type]
