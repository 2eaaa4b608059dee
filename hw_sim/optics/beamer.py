"""The electronics of a real projector: channels, latency, bit planes and raster.

The ordinary projector of the world shows the green codes of a frame evenly from the blank of their flip. Real ones
differ by kind (``KINDS``). A frame is a row of *windows*: in each, one LED shows one channel of the signal, bit plane
by bit plane; between windows it is dark. While its LED is on, white is as bright as the ordinary projector's, so that a
kind with dark times gives less light in a frame. ``light_engine`` has the sources for bit planes in general.
"""

# Symbols:
#   window    channel (0 red, 1 green, 2 blue of the signal), begin and end as shares of a frame, brightness of its LED
#   planes    of a window: the bit of each flash, in order, and its end as a share of the window
#   begin_s   time since the first light of the frame: its blank, `latency_blanks` later, and `late_us` after that

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from hw_sim.optics.light_engine import LightEngine
from hw_sim.optics.projector import BLACK, Light, LightSlice

Array = NDArray[np.float64]
Codes = NDArray[np.uint8]
Signal = tuple[Codes, Codes, Codes]
"""Red, green and blue on the cable, (768, 1024) uint8 each; equal channels share an array."""

CHANNELS = "RGB"
GREEN = 1
GREEN_PART, RED_PART, BLUE_PART = 0.45, 0.27, 0.22
"""Shares of a frame in video mode. Green about 45 %: TI E2E 846053, of a DLPC34xx; how the rest is divided is an estimate."""
DARK_PART = 0.012
"""Share of a frame that is dark after each sub-frame of ``pattern`` and ``repeats``, 0.2 ms of 60 Hz. That there is dark time
before and after each exposure: data sheet of the DLPC3478, 8-bit external pattern mode; how much is the user's, here an estimate."""
LATE_US = 120.0
"""Estimate: load and reset of the mirrors before the first window."""
COLOUR_WEIGHTS = (0.02, 1.0, 0.03)
"""Brightness of LEDs of 620, 530 and 460 nm to a camera behind a bandpass filter of some 80 nm about 530 nm. Estimate: such a filter
passes a percent or so of light 70 to 90 nm off its middle, and a blue LED has a tail towards it."""
VIDEO_BITS = 10
"""Bits of a level in video, an estimate. The other kinds show the signal's own, 1:1 (data sheet of the DLPC3478)."""
SPLIT_BITS = 6
"""Bits above this one, in video, are split into pieces as long as it, so that no colour flickers (Hornbeck, as in ``light_engine``)."""
LINEAR = 0.01
"""Largest distance of the light from a straight line in the code, and largest share of other images, that is linear."""


class Window(NamedTuple):
    """A part of a frame in which one LED shows one channel."""

    channel: int
    """0 red, 1 green, 2 blue of the signal."""
    begin: float
    end: float
    """Shares of a frame."""
    brightness: float
    """Brightness of the LED to the cameras, relative to green."""


@dataclass(frozen=True, slots=True)
class _Kind:
    """The default properties of a kind of projector."""

    order: str
    latency_blanks: int = 1
    """One: the controller fills a frame buffer and shows it in the next frame (guide of the LightCrafter 4500, DLPU011: delay between
    input and projection)."""
    late_us: float = LATE_US
    lengths: tuple[int, ...] = ()
    """Allowed lengths of an order."""
    letters: str = "G"


KINDS = {
    "ideal": _Kind("G", 0, 0.0, (1,)),
    "video": _Kind("GRGB", lengths=(1, 2, 3, 4, 5, 6), letters=CHANNELS),
    "pattern": _Kind("RGB", lengths=(3,), letters=CHANNELS),
    "repeats": _Kind("GG", lengths=(2,)),
}
"""``ideal``: the light is constant during a frame. ``video``: colours in turn, as a DLPC34xx shows video. ``pattern``: three sub-frames of 8 bits,
one channel each, all by the green LED (DLPC3478, DLPC3479). ``repeats``: green twice in each frame (a DLPC350; SLStudio #16)."""


@dataclass(frozen=True, slots=True)
class Beamer:
    """A projector: its kind and its settings. Raises ValueError for impossible ones."""

    kind: str = "ideal"
    latency_blanks: int | None = None
    """Number of blanks from the flip of an image to its first light; ``None``: that of the kind."""
    late_us: float | None = None
    """Time from that blank to the first light; ``None``: that of the kind."""
    order: str | None = None
    """Channels of the windows in order; ``None``: that of the kind."""
    planes_seed: int = 1
    """Draws the order of the bit planes, which controllers do not publish."""
    gamma: float | None = None
    """Light is the code to this power; ``None``: ``imaging.response`` if the kind is ``ideal``, else linear."""
    scaled: tuple[int, int] | None = None
    """Columns and rows of a chip to which the image is resampled; ``None``: the signal's raster."""
    mirrored: bool = False
    """A pixel drawn at column u lights at 1023 − u."""
    upside_down: bool = False
    """A pixel drawn at row v lights at 767 − v."""
    colour_weights: tuple[float, float, float] = COLOUR_WEIGHTS
    """Brightness of the red, green and blue LED to the cameras; matters to ``video`` alone."""

    def __post_init__(self) -> None:
        if not isinstance(self.kind, str) or self.kind not in KINDS:
            raise ValueError(f"kind = {self.kind!r:.80}; allowed are {', '.join(KINDS)}; choose one of them")
        for name, lowest, highest, unit in _NUMBERS:
            value = getattr(self, name)
            is_integer = unit == "whole numbers"
            number = isinstance(value, int if is_integer else (int, float)) and not isinstance(value, bool)
            if value is not None and not (number and lowest <= value <= highest):
                raise ValueError(
                    f"{name} = {value!r:.80}; allowed are {unit} {lowest:g}..{highest:g}; "
                    "leave it out for the usual one"
                )
        for name in ("mirrored", "upside_down"):
            if not isinstance(getattr(self, name), bool):
                raise ValueError(
                    f"{name} = {getattr(self, name)!r:.80}; allowed are true and false; leave it out for false"
                )
        self._check_order()
        self._check_scaled()
        weights = self.colour_weights
        if (
            not isinstance(weights, tuple)
            or len(weights) != 3
            or not all(isinstance(w, (int, float)) and 0.0 <= w <= 1.0 for w in weights)
        ):
            raise ValueError(
                f"colour_weights = {weights!r:.80}; allowed are three numbers 0..1, of red, green, blue; leave it out"
            )

    def _check_order(self) -> None:
        kind = KINDS[self.kind]
        if self.order is None:
            return
        if (
            not isinstance(self.order, str)
            or len(self.order) not in kind.lengths
            or not set(self.order) <= set(kind.letters)
        ):
            lengths = f"{min(kind.lengths)} to {max(kind.lengths)}" if len(kind.lengths) > 1 else str(kind.lengths[0])
            raise ValueError(
                f"order = {self.order!r:.80} of kind '{self.kind}'; allowed: {lengths} of the letters {kind.letters}; "
                f"leave it out for {kind.order}"
            )

    def _check_scaled(self) -> None:
        raster = self.scaled
        if raster is None:
            return
        are_integers = isinstance(raster, tuple) and all(isinstance(n, int) and not isinstance(n, bool) for n in raster)
        if not are_integers or len(raster) != 2 or not all(240 <= n <= 4096 for n in raster):
            raise ValueError(
                f"scaled = {raster!r:.80}; allowed are two whole numbers 240..4096, columns and rows of the chip, "
                "for example [912, 1140]; leave it out for the signal's own"
            )

    @property
    def usual(self) -> bool:
        """True for the projector of the ordinary world."""
        same_time = self.kind == "ideal" and self.latency == 0 and self.late_s == 0.0
        return same_time and self.gamma is None and self.scaled is None and not (self.mirrored or self.upside_down)

    @property
    def latency(self) -> int:
        """Number of blanks from flip to light."""
        return KINDS[self.kind].latency_blanks if self.latency_blanks is None else self.latency_blanks

    @property
    def late_s(self) -> float:
        """Time from that blank to the first light."""
        return (KINDS[self.kind].late_us if self.late_us is None else self.late_us) / 1e6

    # ------------------------------------------------------------------------------------------ time

    @property
    def windows(self) -> tuple[Window, ...]:
        """The windows of a frame, in order."""
        order = self.order or KINDS[self.kind].order
        if self.kind == "ideal":
            return (Window(GREEN, 0.0, 1.0, 1.0),)
        if self.kind != "video":
            return tuple(
                Window(CHANNELS.index(letter), k / len(order), (k + 1) / len(order) - DARK_PART, 1.0)
                for k, letter in enumerate(order)
            )
        parts = {"R": RED_PART, "G": GREEN_PART, "B": BLUE_PART}
        dark = (1.0 - sum(parts.values())) / len(order)
        begin, windows = 0.0, []
        for letter in order:
            channel, length = CHANNELS.index(letter), parts[letter] / order.count(letter)
            windows.append(Window(channel, begin, begin + length, self.colour_weights[channel]))
            begin += length + dark
        return tuple(windows)

    @property
    def planes(self) -> int:
        """Number of bit planes in a window."""
        return VIDEO_BITS if self.kind == "video" else np.iinfo(np.uint8).bits

    def pieces(self) -> tuple[NDArray[np.int64], Array]:
        """Return the bit of each flash of a window, in order, and its end as a share of the window."""
        split = SPLIT_BITS if self.kind == "video" else self.planes
        bits = np.concatenate([np.full(max(1, 2 ** (b - split)), b) for b in range(self.planes)])
        bits = np.random.default_rng([self.planes_seed, 41]).permutation(bits)
        ends = np.cumsum(np.minimum(2.0**bits, 2.0**split))
        return bits, ends / ends[-1]

    def tables_s(
        self, begin_s: float, end_s: float, frame_s: float, response: Light, engine: LightEngine
    ) -> list[Light]:
        """Return the light of each code of red, green and blue between two times, (256,) float32 each.

        It is in seconds of white. The times count from the first light of the frame, 0..``frame_s``. ``response`` and
        ``engine`` matter only for the kind ``ideal``.
        """
        tables = [np.zeros(256, np.float32) for _ in CHANNELS]
        if self.kind == "ideal":
            tables[GREEN] = engine.table_s(self._response(response), begin_s, end_s, frame_s)
            return tables
        levels = np.rint(self._codes() * (2**self.planes - 1)).astype(np.int64)
        on = (levels[:, None] >> np.arange(self.planes)) & 1
        bits, ends = self.pieces()
        starts = np.concatenate([[0.0], ends[:-1]])
        for window in self.windows:
            first_s, length_s = window.begin * frame_s, (window.end - window.begin) * frame_s
            seconds = np.minimum(end_s, first_s + ends * length_s) - np.maximum(begin_s, first_s + starts * length_s)
            plane_s = np.bincount(bits, np.maximum(seconds, 0.0), self.planes)
            # The light of a mirror that is off also needs the LED to be on.
            light = (1.0 - BLACK) * (on @ plane_s) + BLACK * plane_s.sum()
            tables[window.channel] += (window.brightness * light).astype(np.float32)
        return tables

    def _codes(self) -> Array:
        return (np.arange(256) / 255.0) ** (1.0 if self.gamma is None else self.gamma)

    def _response(self, response: Light) -> Light:
        if self.gamma is None:
            return response
        return (BLACK + (1.0 - BLACK) * self._codes()).astype(np.float32)

    # ------------------------------------------------------------------------------------------ space

    def on_chip(self, codes: Codes) -> Codes:
        """Return a channel's codes (rows, columns) uint8 on the chip's raster, mirrored as it is mounted."""
        turned = codes[:: -1 if self.upside_down else 1, :: -1 if self.mirrored else 1]
        if self.scaled is None:
            return np.ascontiguousarray(turned)
        return np.asarray(
            cv2.resize(np.ascontiguousarray(turned), self.scaled, interpolation=cv2.INTER_LINEAR), np.uint8
        )

    def on_raster(self, light: NDArray[np.float32], shape: tuple[int, ...]) -> Light:
        """Return the light (rows, columns) of the chip on the signal's raster of that shape, by area."""
        if light.shape == shape:
            return light
        return np.asarray(cv2.resize(light, (shape[1], shape[0]), interpolation=cv2.INTER_AREA), np.float32)

    def lights(self, signal: Signal) -> Codes:
        """Return the green codes (768, 1024) uint8 of a signal at their places in the scene."""
        chip = self.on_chip(signal[GREEN])
        return np.rint(self.on_raster(chip.astype(np.float32), signal[GREEN].shape)).astype(np.uint8)


_NUMBERS = (
    ("latency_blanks", 0, 3, "whole numbers"),
    ("late_us", 0.0, 1000.0, "numbers"),
    ("planes_seed", 0, 2**31, "whole numbers"),
    ("gamma", 1.0, 3.0, "numbers"),
)


# ---------------------------------------------------------------------------------------------- what an exposure sees


@dataclass(frozen=True, slots=True)
class BeamerSlice(LightSlice):
    """One frame of a ``Beamer`` during a part of an exposure.

    ``image`` is its green; ``since_blank_s`` counts from its first light.
    """

    beamer: Beamer = Beamer()
    red: Codes | None = None
    blue: Codes | None = None
    """The other channels' codes, like ``image``; ``None``: equal to it."""

    def key(self) -> tuple[Hashable, ...]:
        """Return a key that is equal for equal light: the time in the frame and each channel matter."""
        colours = tuple(
            None if part is None else zlib.crc32(part.tobytes()) for part in (self.red, self.image, self.blue)
        )
        return colours, round(self.duration_s, 6), round(self.since_blank_s, 6), self.beamer

    @property
    def signal(self) -> Signal:
        """The three channels."""
        return (
            (self.image if self.red is None else self.red),
            self.image,
            (self.image if self.blue is None else self.blue),
        )


@dataclass(frozen=True, slots=True)
class ShownFrame:
    """An image that is scanned out from one blank on."""

    begin_ns: int
    signal: Signal
    dark: bool = False
    """The LEDs were off from this blank to the next."""


def slices_of(
    beamer: Beamer, frames: Sequence[ShownFrame], start_ns: int, end_ns: int, frame_s: float
) -> list[BeamerSlice]:
    """Return the slices of an exposure, from its start on.

    ``frames`` are those of successive blanks; it is dark before the first.
    """
    black = np.zeros_like(frames[-1].signal[GREEN])
    slices, until_ns, late_ns = [], end_ns, round(beamer.late_s * 1e9)
    for number in range(len(frames) - 1, -1, -1):
        frame = frames[number]
        begin_ns = max(frame.begin_ns + late_ns, start_ns)
        if until_ns > begin_ns:
            shown = number - beamer.latency
            red, green, blue = (black, black, black) if shown < 0 or frame.dark else frames[shown].signal
            since_s = (begin_ns - frame.begin_ns - late_ns) / 1e9
            red_blue = (None if red is green else red, None if blue is green else blue)
            slices.append(BeamerSlice(green, (until_ns - begin_ns) / 1e9, since_s, frame_s, beamer, *red_blue))
            until_ns = begin_ns
    if until_ns > start_ns:
        slices.append(BeamerSlice(black, (until_ns - start_ns) / 1e9, 0.0, frame_s, beamer))
    return slices[::-1]


def beamed_between(
    slices: Sequence[BeamerSlice],
    begin_s: float,
    end_s: float,
    response: Light,
    engine: LightEngine,
    brightness: Callable[[int, float], float],
) -> Light | None:
    """Return the same as ``projector.light_between``, of a ``Beamer``.

    ``brightness``: factor of the slice of that number, at that time after the start of the exposure.
    """
    total: Light | None = None
    at_s = 0.0
    for number, part in enumerate(slices):
        first_s, last_s = max(begin_s, at_s), min(end_s, at_s + part.duration_s)
        if last_s > first_s:
            since_s = part.since_blank_s - at_s
            tables = part.beamer.tables_s(since_s + first_s, since_s + last_s, part.frame_s, response, engine)
            light = _light(part, tables, brightness(number, first_s))
            total = light if total is None else np.asarray(total + light, np.float32)
        at_s += part.duration_s
    return total


def _light(part: BeamerSlice, tables: list[Light], brightness: float) -> Light:
    # Equal channels are looked up once, and a channel whose LED was off not at all.
    together: dict[int, Light] = {}
    signal = part.signal
    for channel, table in zip(signal, tables, strict=True):
        if table.any():
            together[id(channel)] = together.get(id(channel), np.zeros(256, np.float32)) + table
    chips = {id(channel): part.beamer.on_chip(channel) for channel in signal if id(channel) in together}
    lights = [cv2.LUT(chips[key], table * np.float32(brightness)) for key, table in together.items()]
    if not lights:
        return np.zeros(part.image.shape, np.float32)
    return part.beamer.on_raster(np.asarray(sum(lights[1:], lights[0]), np.float32), part.image.shape)


# ---------------------------------------------------------------------------------------------- the truth of it


class TrueWindow(NamedTuple):
    """Light of one channel (``R``, ``G`` or ``B`` of the signal), µs since the blank of the first light."""

    channel: str
    begin_us: float
    end_us: float


@dataclass(frozen=True, slots=True)
class ProjectorTruth:
    """The true values for a measurement of a world's projector."""

    beamer: Beamer
    frame_us: float
    response: Light
    """Light of each code, for the kind ``ideal`` without gamma."""

    @property
    def latency_blanks(self) -> int:
        """Number of blanks from the flip of an image to its first light.

        A delay, here and in the other methods, counts from the latter.
        """
        return self.beamer.latency

    @property
    def windows_us(self) -> tuple[TrueWindow, ...]:
        """The times of light in a frame, in order."""
        late_us = self.beamer.late_s * 1e6
        return tuple(
            TrueWindow(CHANNELS[w.channel], late_us + w.begin * self.frame_us, late_us + w.end * self.frame_us)
            for w in self.beamer.windows
        )

    def light_of_codes(self, delay_us: float, exposure_us: float, channels: str = "RGB") -> Array:
        """Return the light (256,) of an image of each code in ``channels``, 0 in the others, in µs of white.

        It is that of an exposure that begins ``delay_us`` after the blank. Images before and after are not counted.
        """
        late_us = self.beamer.late_s * 1e6
        begin_us, end_us = (
            min(max(time_us - late_us, 0.0), self.frame_us) for time_us in (delay_us, delay_us + exposure_us)
        )
        if end_us <= begin_us:
            return np.zeros(256)
        times = (begin_us / 1e6, end_us / 1e6, self.frame_us / 1e6)
        tables = self.beamer.tables_s(*times, self.response, LightEngine())
        light = np.zeros(256)
        for letter, table in zip(CHANNELS, tables, strict=True):
            light += 1e6 * (table.astype(np.float64) if letter in channels else float(table[0]))
        return light

    def residual(self, delay_us: float, exposure_us: float, channels: str = "RGB") -> float:
        """Return the largest residual of that light from its best-fit line in the code, relative to white.

        It is infinite if the light does not depend on the code.
        """
        codes, light = np.arange(256.0), self.light_of_codes(delay_us, exposure_us, channels)
        slope, offset = np.polyfit(codes, light, 1)
        if slope <= 1e-6:
            return math.inf
        return float(np.abs(light - offset - slope * codes).max() / light[255])

    def foreign(self, delay_us: float, exposure_us: float, channels: str = "RGB") -> float:
        """Return the share of an exposure's light by the images before and after, if all of them are white."""
        own_light = self.light_of_codes(delay_us, exposure_us, channels)[255]
        other_light = 0.0
        frames = math.ceil((delay_us + exposure_us) / self.frame_us) + 1
        for number in range(-2, frames):
            if number:
                other_light += self.light_of_codes(delay_us - number * self.frame_us, exposure_us, channels)[255]
        return float(other_light / (own_light + other_light)) if own_light + other_light > 0.0 else 0.0

    def linear(self, delay_us: float, exposure_us: float, channels: str = "RGB") -> bool:
        """Return True if the light of that exposure is linear in the code and nearly free of other images.

        Both limits are 1 %. ``channels``: those with the image, such as ``"G"``.
        """
        arguments = (delay_us, exposure_us, channels)
        return self.residual(*arguments) <= LINEAR and self.foreign(*arguments) <= LINEAR
