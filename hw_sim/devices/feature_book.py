"""The values of a maker's features: write rules, user sets, and their effect on sensor and image."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol

from hw_sim.devices.features import (
    BooleanFeature,
    CommandFeature,
    EnumerationFeature,
    FloatFeature,
    IntegerFeature,
    ReadOnlyInteger,
    Settable,
    Value,
    split_key,
)
from hw_sim.devices.gencp_memory import AccessError, Status
from hw_sim.devices.makers import DEFAULT_SET, FRAME_START, Maker
from hw_sim.devices.picture import Processing
from hw_sim.devices.shutter import LINE0, NOWHERE, SOFTWARE, TIMED, TRIGGER_WIDTH, Settings
from hw_sim.devices.u3v_stream import Region

SIZES = {"Width": (0, "OffsetX"), "Height": (1, "OffsetY")}
OFFSETS = {"OffsetX": (0, "Width"), "OffsetY": (1, "Height")}
JOINED = (("BinningHorizontal", "DecimationHorizontal"), ("BinningVertical", "DecimationVertical"))
FALLING_WORDS = {"RisingEdge": "FallingEdge", "FallingEdge": "RisingEdge"}
ACTIVATIONS = {"RisingEdge": 0, "FallingEdge": 1, "AnyEdge": 2}
ACQUISITION_MODES = {"Continuous": 0, "SingleFrame": 1, "MultiFrame": 2}
BURST = "FrameBurstStart"


class Busy(Protocol):
    """The part of a camera that decides whether its shape may change."""

    streaming: bool

    @property
    def acquiring(self) -> bool: ...


class FeatureBook:
    """The values of one camera: after power-on the owner's saved ones, or the factory's.

    Numbers are those of the registers: the number of a choice, 0 or 1, or the value itself.
    """

    def __init__(self, maker: Maker, picture_px: tuple[int, int], saved: Mapping[str, Value], camera: Busy) -> None:
        """``picture_px``: columns and rows of the world's image, in the middle of the sensor."""
        self.maker = maker
        self.sensor = (picture_px[0] + maker.border_px[0], picture_px[1] + maker.border_px[1])
        self._saved, self._camera = saved, camera
        self._settable = maker.settable()
        self._values: dict[tuple[str, str], int | float] = {}
        self._mode_acts = TIMED
        self.load(saved)

    # ------------------------------------------------------------------------------------------ values

    def load(self, over: Mapping[str, Value]) -> None:
        """Set the factory's values, overridden by those of ``over``."""
        self._values = {}
        for feature in self._settable.values():
            differing = feature.differing if isinstance(feature, EnumerationFeature) else {}
            for word in self._words(feature):
                factory = differing.get(word, feature.factory)
                self._values[feature.name, word] = feature.code(factory)
        for key, value in over.items():
            name, word_given = split_key(key)
            feature = self._settable[name]
            for word in self._words(feature) if word_given is None else [word_given]:
                self._values[name, word] = feature.code(value)
        self._fit_region()
        self._note_mode()

    def _words(self, feature: Settable) -> list[str]:
        selector = None if feature.selector is None else self._settable[feature.selector]
        return list(selector.codes) if isinstance(selector, EnumerationFeature) else [""]

    def word_at(self, name: str, instance: str = "") -> str:
        """Return the name of the current choice."""
        feature = self._settable[name]
        assert isinstance(feature, EnumerationFeature)
        number = self._values[name, instance]
        return next(word for word, code in feature.codes.items() if code == number)

    def number(self, name: str, instance: str = "", otherwise: float = 0) -> float:
        """Return a number; ``otherwise`` if the camera has no such feature."""
        return self._values.get((name, instance), otherwise)

    def _instance(self, feature: Settable | CommandFeature) -> str:
        return "" if feature.selector is None else self.word_at(feature.selector)

    def read(self, name: str) -> int | float:
        """Return the value of a register, for the instance that its selector names."""
        feature = self._settable[name]
        return self._values[name, self._instance(feature)]

    def write(self, name: str, value: int | float) -> None:
        """Write a register. Raises AccessError."""
        feature = self._settable[name]
        if self.locked(feature):
            raise AccessError(Status.ACCESS_DENIED)
        if not self._allows(feature, value):
            raise AccessError(Status.INVALID_PARAMETER)
        self._values[name, self._instance(feature)] = value
        if name.startswith(("Binning", "Decimation")):
            self._fit_region()
        if name == "ExposureMode" or not self.maker.mode_after_source:
            self._note_mode()

    def locked(self, feature: Settable) -> bool:
        """Return True if a feature is read-only now."""
        if feature.shapes and (self.number("TLParamsLocked") or self._camera.acquiring or self._camera.streaming):
            return True
        return feature.auto is not None and self.word_at(feature.auto) != "Off"

    def _allows(self, feature: Settable, value: int | float) -> bool:
        match feature:
            case EnumerationFeature():
                return value in feature.codes.values()
            case BooleanFeature():
                return value in (0, 1)
            case FloatFeature():
                return feature.low <= value <= feature.high
            case IntegerFeature():
                high = self.high(feature.name) if feature.computed else feature.high
                return feature.low <= value <= high and (value - feature.low) % feature.step == 0

    # ------------------------------------------------------------------------------------------ region

    def largest(self, axis: int) -> int:
        """Return the columns (axis 0) or rows (1) after binning and decimation."""
        joined = 1.0
        for name in JOINED[axis]:
            joined *= self.number(name, otherwise=1)
        return int(self.sensor[axis] // joined)

    def high(self, name: str) -> int:
        """Return the upper limit of a size or an offset."""
        axis, counterpart = (SIZES | OFFSETS)[name]
        return self.largest(axis) - int(self.number(counterpart))

    def _fit_region(self) -> None:
        """Shrink size and offset until they fit: cameras do so when binning changes, or a set is loaded."""
        for name, (axis, offset) in SIZES.items():
            size, shift = self._settable[name], self._settable[offset]
            assert isinstance(size, IntegerFeature)
            assert isinstance(shift, IntegerFeature)
            largest = self.largest(axis)
            offset_px = int(self.number(offset))
            self._values[offset, ""] = min(offset_px, (largest - size.low) // shift.step * shift.step)
            room = largest - int(self.number(offset))
            fitting = min(int(self.number(name)), room)
            self._values[name, ""] = size.low + (fitting - size.low) // size.step * size.step

    @property
    def region(self) -> Region:
        """The region that is read out, and its format."""
        width, height, x, y = (int(self.number(name)) for name in ("Width", "Height", "OffsetX", "OffsetY"))
        return Region(width, height, x, y, int(self.number("PixelFormat")), bool(self.number("ChunkModeActive")))

    @property
    def rows(self) -> float:
        """The fraction of the sensor's rows that is read."""
        return self.number("Height") / self.largest(1)

    def shown(self, feature: ReadOnlyInteger) -> int:
        """Return the value of a read-only feature."""
        match feature.name:
            case "SensorWidth" | "SensorHeight":
                return self.sensor[feature.name == "SensorHeight"]
            case "WidthMax" | "HeightMax":
                return self.largest(int(feature.name == "HeightMax"))
            case _:
                return self.region.payload_bytes

    # ------------------------------------------------------------------------------------------ user sets

    def load_selected(self) -> None:
        """Execute UserSetLoad. Raises AccessError."""
        if self.number("TLParamsLocked") or self._camera.acquiring or self._camera.streaming:
            raise AccessError(Status.ACCESS_DENIED)
        chosen = self.word_at("UserSetSelector")
        number = self._values["UserSetSelector", ""]
        self.load({} if chosen == DEFAULT_SET else self._saved)
        # The selector is in no set.
        self._values["UserSetSelector", ""] = number

    # ------------------------------------------------------------------------------------------ what it means

    def _note_mode(self) -> None:
        """Apply ExposureMode; with some makers only if the trigger that it needs is already set."""
        mode = TRIGGER_WIDTH if self.word_at("ExposureMode") == "TriggerWidth" else TIMED
        has_trigger = self._on(FRAME_START) and self._source(FRAME_START) != SOFTWARE
        self._mode_acts = mode if has_trigger or not self.maker.mode_after_source else TIMED

    def _on(self, trigger: str) -> bool:
        return self.word_at("TriggerMode", trigger) == "On"

    def _source(self, trigger: str) -> int:
        word = self.word_at("TriggerSource", trigger)
        if word == "Software":
            return SOFTWARE
        wired = word == self.maker.trigger_line and self.word_at("LineMode", word) == "Input"
        return LINE0 if wired else NOWHERE

    def software_trigger_is_for_frames(self) -> bool:
        """Return True if TriggerSoftware triggers frames, by the trigger's selector."""
        return self.word_at("TriggerSelector") == FRAME_START

    def settings(self) -> Settings:
        """Return the sensor timing that follows from the features."""
        edge = self.word_at("TriggerActivation", FRAME_START)
        line = self.word_at("TriggerSource", FRAME_START)
        if line != "Software" and self.number("LineInverter", line):
            edge = FALLING_WORDS.get(edge, edge)
        selectors = self._settable["TriggerSelector"]
        assert isinstance(selectors, EnumerationFeature)
        active_triggers = [word for word in selectors.codes if word != FRAME_START and self._on(word)]
        # A trigger that begins or ends an exposure has no line here: a host that turns it on waits for ever.
        acquisition_triggers = [word for word in active_triggers if word in (BURST, "AcquisitionStart")]
        sources = [self._source(word) for word in acquisition_triggers] + [NOWHERE] * (
            len(active_triggers) - len(acquisition_triggers)
        )
        each = int(self.number("AcquisitionBurstFrameCount")) if BURST in active_triggers else None
        rate_hz = self.number("AcquisitionFrameRate")
        limited = bool(self.number("AcquisitionFrameRateEnable"))
        overlap = self.maker.overlap
        overlaps = overlap is None or self.word_at(overlap[0], self._overlap_instance()) == overlap[1]
        s = Settings()
        s.acquisition_mode = ACQUISITION_MODES[self.word_at("AcquisitionMode")]
        s.frame_count = int(self.number("AcquisitionFrameCount"))
        s.frame_rate_mhz = round(1000 * rate_hz) if limited else 10**12 // self.maker.readout_ns
        s.trigger_on = int(self._on(FRAME_START))
        s.trigger_source = self._source(FRAME_START)
        s.trigger_activation = ACTIVATIONS[edge]
        s.trigger_delay_ns = round(1000 * self.number("TriggerDelay", FRAME_START))
        s.exposure_mode = self._mode_acts
        s.exposure_us = round(self.number("ExposureTime"))
        s.gain_tenth_db = round(10 * self.number("Gain", "All"))
        s.exposure_auto, s.gain_auto = int(self.number("ExposureAuto")), int(self.number("GainAuto"))
        s.readout_ns = self.maker.readout_ns
        s.link_limit_ns = self._link_limit_ns()
        s.overlaps = overlaps
        if self._mode_acts == TRIGGER_WIDTH and "ExposureOverlapTimeMax" in self._settable:
            s.overlap_ns = round(1000 * self.number("ExposureOverlapTimeMax"))
        s.least_period_ns = round(1e9 / rate_hz) if limited else 0
        s.width_offset_ns = 1000 * self.maker.width_offset_us
        s.held_by = max(sources) if sources else None
        s.frames_each = each
        return s

    def _overlap_instance(self) -> str:
        assert self.maker.overlap is not None
        return "" if self._settable[self.maker.overlap[0]].selector is None else FRAME_START

    def _link_limit_ns(self) -> int:
        if self.number("DeviceLinkThroughputLimitMode", otherwise=1) == 0:
            return 0
        return round(self.region.payload_bytes / self.number("DeviceLinkThroughputLimit") * 1e9)

    @property
    def processing(self) -> Processing:
        """Return the processing of each image."""
        horizontal, vertical = (tuple(int(self.number(name, otherwise=1)) for name in names) for names in JOINED)
        gamma = self.number("Gamma") if self.number("GammaEnable", otherwise=1) else 1.0
        return Processing(
            reverse_x=bool(self.number("ReverseX")),
            reverse_y=bool(self.number("ReverseY")),
            binning=(horizontal[0], vertical[0]),
            decimation=(horizontal[1], vertical[1]),
            black_dn=self.maker.black_dn * self.number("BlackLevel", "All"),
            gamma=gamma,
            lut=bool(self.number("LUTEnable")),
            pattern=self.word_at("TestPattern"),
        )
