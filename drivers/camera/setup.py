"""Setting a camera before it streams: the order of its settings, and the check that each was accepted.

A camera may wake up in any state: binned, mirrored, limited, triggered by another line. So all settings of an image are
made at each opening, one after the other, and read back. The order matters: some features may only be written, or only
act, once others have their values (SFNC 2.7; the makers' manuals say which). A setting that a camera does not offer is
noted; one that it holds otherwise than requested is refused.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from drivers.api import CameraSettings, CameraSpec, DeviceRefused, FeatureValue, HeldSetting
from drivers.camera.features import Features

OWN_KEYS = {
    "Width": "width_px",
    "Height": "height_px",
    "OffsetX": "offset_x_px",
    "OffsetY": "offset_y_px",
    "PixelFormat": "pixel_format",
    "ExposureTime": "exposure_ms",
    "Gain": "gain_db",
}
"""Features that have their own key in the rig file."""
MAY_BE_MISSING = "?"
"""Mark before the name of a feature that not every camera of a kind has."""
_TOLERANCE, _EXPOSURE_TOLERANCE_US, _GAIN_TOLERANCE_DB = 0.01, 20.0, 0.11
"""Accepted rounding: of any number as a share of it, of an exposure, and of a gain, whose steps may be 0.1 dB or those
of a coarser table.
"""


@dataclass(frozen=True, slots=True)
class _Setting:
    """One feature and its value.

    ``choices``: the first of these symbols that is offered; empty: the value itself.
    """

    feature: str
    value: FeatureValue
    choices: tuple[str, ...] = ()


_LIGHT = ("ExposureTime", "Gain")
_FRAME_START = "FrameStart"
_FORMAT = (
    _Setting("BinningHorizontal", 1),
    _Setting("BinningVertical", 1),
    _Setting("DecimationHorizontal", 1),
    _Setting("DecimationVertical", 1),
    _Setting("ReverseX", value=False),
    _Setting("ReverseY", value=False),
)
"""Settings that come before the size, whose limits depend on them."""
_PLAIN = (
    _Setting("ChunkModeActive", value=False),
    _Setting("TestPattern", "Off"),
    _Setting("TestImageSelector", "Off"),
    _Setting("AcquisitionMode", "Continuous"),
    # Without a trigger it would be the camera's own pace; with one it makes some cameras skip triggers.
    _Setting("AcquisitionFrameRateEnable", value=False),
)
_INPUT = (_Setting("LineMode", "Input"), _Setting("LineInverter", value=False))
_LIGHT_FIRST = (_Setting("ExposureMode", "Timed"), _Setting("ExposureAuto", "Off"))
_TONE = (
    _Setting("BlackLevelAuto", "Off"),
    _Setting("GammaEnable", value=False),
    _Setting("LUTEnable", value=False),
)


class CameraSetup:
    """Sets one camera; used by the thread that configures it.

    Every method raises DeviceRefused, which names the feature, the value and the remedy, and DeviceGone.
    """

    def __init__(self, spec: CameraSpec, features: Features) -> None:
        """Refuse ``spec.features`` that have their own keys in the rig file."""
        self._name = spec.name
        self._spec = spec
        self._features = features
        self._missing: dict[str, str] = {}
        self._bends_grey: tuple[str, ...] = ()
        self._wanted: dict[str, FeatureValue] = {}
        self._instead, self._after = self._sorted(spec.features)
        self._source_feature = self._instead.pop("TriggerSource", (None, False))[0]

    @property
    def notes(self) -> tuple[str, ...]:
        """Settings that this camera does not offer, in their order."""
        return tuple(self._missing.values())

    @property
    def bends_grey(self) -> tuple[str, ...]:
        """Features with which grey values are not proportional to light, as the camera holds them.

        The rig file sets them under features.
        """
        return self._bends_grey

    def read_back(self) -> tuple[HeldSetting, ...]:
        """Return every setting of the last ``apply``, in its order, as the camera holds it now.

        The missing ones follow.
        """
        features = self._features
        settings = [
            HeldSetting(name, requested_value, features.value(name)) for name, requested_value in self._wanted.items()
        ]
        # Exposure and gain have no requested value here: they come in steps, and only the camera's values count.
        light = [HeldSetting(name, None, features.value(name)) for name in _LIGHT if features.has(name)]
        return (*settings, *light, *(HeldSetting(name, None, None) for name in self._missing))

    def load_defaults(self) -> None:
        """Load the maker's default state, so that settings saved in the camera do not count. At opening only."""
        features = self._features
        if not (features.has("UserSetSelector") and features.has("UserSetLoad")):
            self._note("UserSetLoad", "no user sets")
        elif "Default" not in features.choices("UserSetSelector") or not features.writable("UserSetSelector"):
            self._note("UserSetLoad", "no user set Default")
        else:
            features.choose("UserSetSelector", "Default")
            features.execute("UserSetLoad")
            features.forget()

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Set all features, in order, and return exposure and gain as the camera holds them."""
        self._wanted.clear()
        self._format(settings)
        self._trigger()
        result = self.light(settings)
        for setting in _TONE:
            self._set(setting)
        if not self._features.has("GammaEnable") or self._holds("GammaEnable", value=True):
            self._set(_Setting("Gamma", 1.0))
        for extra in self._after:
            self._set_extra(extra)
            if not extra[0].startswith("Trigger"):
                self._wanted.pop(extra[0], None)  # its earlier value is behind another selector now
        for name in self._instead.keys() - self._wanted.keys() - self._missing.keys():
            self._set(_Setting(name, self._instead[name][0]))  # this camera skipped its place in the order
        self._set(_Setting("TriggerSelector", _FRAME_START))
        self._verify()
        self._bends_grey = tuple(self._look_at_grey())
        return result

    def light(self, settings: CameraSettings) -> CameraSettings:
        """Set exposure and gain alone, and return them as the camera holds them."""
        features = self._features
        for setting in _LIGHT_FIRST:
            self._set(setting)
        exposure_us = features.set_number("ExposureTime", settings.exposure_us)
        self._near("ExposureTime", settings.exposure_us, exposure_us, _EXPOSURE_TOLERANCE_US, "µs", "exposure_ms")
        self._set(_Setting("GainAuto", "Off"))
        gain_db = 0.0
        if features.has("Gain"):
            self._set(_Setting("GainSelector", "All", ("All", "AnalogAll")))
            gain_db = features.set_number("Gain", settings.gain_db)
            self._near("Gain", settings.gain_db, gain_db, _GAIN_TOLERANCE_DB, "dB", "gain_db")
        elif settings.gain_db != 0.0:
            raise DeviceRefused(self._name, "has no gain to set", "Set gain_db = 0 in the rig file")
        return CameraSettings(settings.width_px, settings.height_px, exposure_us, gain_db)

    # ------------------------------------------------------------------------------------------- the order

    def _format(self, settings: CameraSettings) -> None:
        features = self._features
        self._throughput()
        for setting in _FORMAT:
            self._set(setting)
        features.choose("PixelFormat", self._spec.pixel_format)
        self._wanted["PixelFormat"] = self._spec.pixel_format
        # Offsets first: they limit the size that is allowed.
        for offset in ("OffsetX", "OffsetY"):
            if features.has(offset) and features.writable(offset):
                features.set_number(offset, 0)
        for feature, requested_px in (("Width", settings.width_px), ("Height", settings.height_px)):
            got = features.set_number(feature, requested_px)
            if got != requested_px:
                raise DeviceRefused(
                    self._name, f"{feature}: asked for {requested_px} px, got {got:g} px", "Correct the rig's size"
                )
            self._wanted[feature] = requested_px
        self._offset("OffsetX", self._spec.offset_x_px)
        self._offset("OffsetY", self._spec.offset_y_px)
        for setting in _PLAIN:
            self._set(setting)

    def _throughput(self) -> None:
        """Let the camera send as fast as it can: a limit would make it drop triggers at 60 Hz."""
        features = self._features
        mode = "DeviceLinkThroughputLimitMode"
        if mode in self._instead or (features.has(mode) and "Off" in features.choices(mode)):
            self._set(_Setting(mode, "Off"))
        elif features.has("DeviceLinkThroughputLimit") and features.writable("DeviceLinkThroughputLimit"):
            self._set(_Setting("DeviceLinkThroughputLimit", features.limits("DeviceLinkThroughputLimit").high))

    def _offset(self, feature: str, requested_px: int | None) -> None:
        """Set the image's place on the sensor. ``None``: its middle, where lenses are best."""
        features = self._features
        if not features.has(feature):
            if requested_px:
                raise DeviceRefused(
                    self._name, f"has no {feature} to set to {requested_px} px", f"Leave out {OWN_KEYS[feature]}"
                )
            return
        limits = features.limits(feature)
        middle_px = int(limits.high / 2 // limits.step * limits.step)
        value = middle_px if requested_px is None else requested_px
        if features.number(feature) != value:
            got = features.set_number(feature, value)
            if got != value:
                raise DeviceRefused(
                    self._name, f"{feature}: asked for {value} px, got {got:g} px",
                    f"Correct {OWN_KEYS[feature]}: 0 to {limits.high:g} in steps of {limits.step:g}",
                )  # fmt: skip
        self._wanted[feature] = value

    def _trigger(self) -> None:
        """Make each pulse on the board's line one frame, and switch all other triggers off."""
        features = self._features
        source = self._source()
        if features.writable("TriggerSelector"):
            # A trigger that is left on waits for a signal that never comes, or starts extra frames.
            for selector in features.choices("TriggerSelector"):
                features.choose("TriggerSelector", selector)
                if features.writable("TriggerMode"):
                    features.choose("TriggerMode", "Off")
        if features.has("LineSelector") and source in features.choices("LineSelector"):
            features.choose("LineSelector", source)
            for setting in _INPUT:
                self._set(setting)
        self._set(_Setting("TriggerSelector", _FRAME_START))
        features.choose("TriggerSource", source)
        self._wanted["TriggerSource"] = source
        self._set(_Setting("TriggerActivation", "RisingEdge"))
        # Without it a trigger during read-out is ignored: 60 Hz become 30.
        self._set(_Setting("TriggerOverlap", "ReadOut", ("ReadOut", "PreviousFrame")))
        self._set(_Setting("OverlapMode", "On"))
        self._set(_Setting("TriggerDelay", 0.0))
        # Before the exposure's mode, which on some cameras acts only with the trigger on.
        features.choose("TriggerMode", "On")
        self._wanted["TriggerMode"] = "On"

    def _source(self) -> str:
        named = self._spec.trigger_source
        under_features = self._source_feature
        if named is not None and under_features not in (None, named):
            raise DeviceRefused(
                self._name, f"TriggerSource is {under_features!r} under features and trigger_source is {named!r}",
                "Leave one of them out",
            )  # fmt: skip
        if named is not None or under_features is not None:
            return str(under_features if named is None else named)
        lines = [symbol for symbol in self._features.choices("TriggerSource") if symbol.startswith("Line")]
        if not lines:
            raise DeviceRefused(self._name, "offers no line as trigger source", "Use a triggerable camera")
        return lines[0]

    # ------------------------------------------------------------------------------------------- one setting

    def _sorted(
        self, extras: Sequence[tuple[str, FeatureValue]]
    ) -> tuple[dict[str, tuple[FeatureValue, bool]], list[tuple[str, FeatureValue, bool]]]:
        """Return the features that replace built-in settings, and those that follow.

        Each has True if it may be missing. Features after a selector in the table belong to it, and follow with it.
        """
        instead: dict[str, tuple[FeatureValue, bool]] = {}
        after: list[tuple[str, FeatureValue, bool]] = []
        selected = False
        for marked, value in extras:
            name = marked.removeprefix(MAY_BE_MISSING)
            if name in OWN_KEYS:
                raise DeviceRefused(
                    self._name, f"{name} = {value!r} is under features", f"Use the key {OWN_KEYS[name]} for it"
                )
            selected = selected or name.endswith("Selector")
            optional = marked != name
            if name in _BUILT_IN and not selected:
                instead[name] = (value, optional)
            else:
                after.append((name, value, optional))
        return instead, after

    def _set(self, setting: _Setting) -> None:
        """Set a feature that may be missing, unless the rig file replaces it."""
        name, value = setting.feature, setting.value
        features = self._features
        if name in self._instead:
            value, optional = self._instead[name]
            if self._set_extra((name, value, optional)):
                self._wanted[name] = value
            return
        if not features.has(name):
            self._note(name, f"no {name}")
            return
        if isinstance(value, str):
            offered = features.choices(name)
            symbol = next((choice for choice in setting.choices or (value,) if choice in offered), None)
            if symbol is None:
                self._note(name, f"{name} without {value}: stays {features.choice(name)}")
                return
            value = symbol
        self._write(name, value)
        self._wanted[name] = value

    def _set_extra(self, extra: tuple[str, FeatureValue, bool]) -> bool:
        """Set a feature of the rig file; return False where the camera lacks it and may."""
        name, value, optional = extra
        if optional and not self._features.has(name):
            self._note(name, f"no {name}")
            return False
        self._write(name, value)
        return True

    def _write(self, name: str, value: FeatureValue) -> None:
        features = self._features
        if features.has(name) and not features.writable(name):
            if self._holds(name, value):
                return
            raise DeviceRefused(
                self._name,
                f"{name} is {features.value(name)} and cannot be written; it must be {value}",
                f'Set it by the maker\'s program and save it, or give "{name}" another value under features of this camera',
            )
        # Written even if the camera holds it already: on some cameras a mode acts only when written after others.
        features.set_value(name, value)
        if not self._holds(name, value):
            raise self._differs(name, value)

    def _holds(self, name: str, value: FeatureValue) -> bool:
        """Return True if the camera holds this value, numbers within their rounding."""
        held = self._features.value(name)
        if isinstance(value, bool | str) or isinstance(held, bool | str):
            return held == value
        return abs(held - value) <= _TOLERANCE * abs(value)

    def _near(self, name: str, requested: float, got: float, tolerance: float, unit: str, key: str) -> None:
        if abs(got - requested) > max(tolerance, _TOLERANCE * abs(requested)):
            raise DeviceRefused(
                self._name,
                f"{name}: asked for {requested:g} {unit}, got {got:g} {unit}",
                f"Choose a {key} that the camera has",
            )

    def _verify(self) -> None:
        """Read all settings once more: a later one may have changed an earlier one."""
        for name, value in self._wanted.items():
            if not self._holds(name, value):
                raise self._differs(name, value)

    def _differs(self, name: str, value: FeatureValue) -> DeviceRefused:
        return DeviceRefused(
            self._name,
            f"{name} is {self._features.value(name)} after it was set to {value}",
            "Check the rig's camera settings against the camera's manual",
        )

    def _look_at_grey(self) -> Iterator[str]:
        features = self._features
        switched_off = features.has("GammaEnable") and self._holds("GammaEnable", value=False)
        if features.has("Gamma") and not switched_off and not self._holds("Gamma", 1.0):
            yield f"Gamma is {features.number('Gamma'):g}"
        if features.has("LUTEnable") and self._holds("LUTEnable", value=True):
            yield "LUTEnable is on"

    def _note(self, name: str, text: str) -> None:
        self._missing[name] = text


_BUILT_IN = {
    *(setting.feature for setting in (*_FORMAT, *_PLAIN, *_INPUT, *_LIGHT_FIRST, *_TONE)),
    *(
        "DeviceLinkThroughputLimitMode",
        "DeviceLinkThroughputLimit",
        "TriggerActivation",
        "TriggerOverlap",
        "OverlapMode",
    ),
    *("TriggerDelay", "TriggerSource", "Gamma", "GainAuto"),
}
"""Built-in settings whose values a rig file may replace."""
