"""Owns what a screen can show: one frozen value per screen, complete in itself, in physical units.

A view says what is so; it holds no position, no colour and no words of its own. ``None`` is "not known" and is drawn
as a dash, never as zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from appliance.calibration.guide import Session, Step
from appliance.machine.alerts import Alert
from appliance.machine.states import Calibrating
from appliance.screens.texts import Text
from drivers.api import Key

KeyLabels = Mapping[Key, Text | str]
"""What each key does now, as an entry of the table or in English. A key without a label has none drawn."""


def labels(
    scan: Text | None = None, back: Text | None = None, up: Text | None = None, down: Text | None = None
) -> KeyLabels:
    """Labels of the keys that mean something on a screen."""
    given = {Key.SCAN: scan, Key.BACK: back, Key.UP: up, Key.DOWN: down}
    return MappingProxyType({key: text for key, text in given.items() if text is not None})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """What all screens have: alerts, the gravest first, and the meaning of the keys."""

    alerts: tuple[Alert, ...] = ()
    keys: KeyLabels = field(default_factory=labels)


class DeviceResult(Enum):
    WAITING = "waiting"
    WORKS = "works"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class DeviceLine:
    """One device of the self-test, named as in the rig file; ``detail`` is one short line, or empty."""

    device: str
    result: DeviceResult
    detail: str = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BootView(View):
    """Start-up: each device with its result, as soon as it is known. Up to eight lines fit."""

    devices: tuple[DeviceLine, ...]
    version: str
    keys: KeyLabels = field(default_factory=lambda: labels(back=Text.HOLD_OFF))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AimView(View):
    """Live pictures while the diver chooses the place. A picture is (h, w) uint8; ``None`` is a camera without one."""

    left: NDArray[np.uint8] | None
    right: NDArray[np.uint8] | None
    scans_taken: int
    scans_left: int | None
    temperature_c: float | None
    exposure: str | None = None
    """Of the next scan, with its unit; ``None``: nothing to say of it."""
    distance_mm: float | None = None
    """From the laser dots; ``None`` while they are off or not seen."""
    scan_allowed: bool = True
    """Without it the label of SCAN is drawn dim; the reason is an alert."""
    just_saved: str | None = None
    """Number of a scan whose saving is to be confirmed."""
    keys: KeyLabels = field(default_factory=lambda: labels(scan=Text.SCAN, back=Text.HOLD_OFF))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CaptureView(View):
    """The sequence is being recorded: ``frames_done`` of ``frames``."""

    frames_done: int
    frames: int
    keys: KeyLabels = field(default_factory=lambda: labels(back=Text.STOP))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReconstructView(View):
    """Points are being computed; ``progress`` is 0..1, ``None`` where nobody knows."""

    progress: float | None
    keys: KeyLabels = field(default_factory=lambda: labels(back=Text.REPEAT))


class Grade(Enum):
    """The verdict on a scan."""

    GOOD = "good"
    USABLE = "usable"
    BAD = "bad"


class PointValue(Enum):
    """What the colours of a cloud mean."""

    DEPTH = "depth"
    """Distance along z, mm."""
    NOISE = "noise"
    """Expected standard deviation, mm; less is better."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReviewView(View):
    """A scan and its verdict. The coarse cloud comes first; the full one replaces it in a later view.

    ``points_mm`` is (n, 3) float32 in the left camera frame, ``values`` (n,) float32 in mm. The arrays must not
    change while they are shown; the same memory in the next view is not copied again. No points: (0, 3), (0,).
    """

    points_mm: NDArray[np.float32]
    values: NDArray[np.float32]
    value: PointValue
    coarse: bool
    grade: Grade
    points: int
    coverage_percent: float | None
    noise_mm: float | None
    distance_mm: float | None
    duration_s: float | None
    """From the key press to this picture."""
    turn: int = 0
    """How far the diver turned the cloud: steps to the right, negative to the left."""
    keys: KeyLabels = field(
        default_factory=lambda: labels(scan=Text.KEEP, back=Text.REPEAT, up=Text.TURN_RIGHT, down=Text.TURN_LEFT)
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SavingView(View):
    """A scan on its way to the disk. ``saved`` is a promise: set it after the last fsync, not before."""

    scan_id: str
    saved: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibrateView(View):
    """One step of the calibration: what to hold and how, the live pictures, and what became of the latest recording."""

    at: Calibrating
    session: Session
    left: NDArray[np.uint8] | None
    right: NDArray[np.uint8] | None
    scan_allowed: bool = True
    """As in ``AimView``; of meaning at the steps that record."""

    @property
    def step(self) -> Step:
        """The step that is shown."""
        return self.at.step


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FaultView(View):
    """Nothing else can be shown than what is wrong and what to do; ``alert`` fills the screen."""

    alert: Alert
    detail: str = ""
    """One line for who repairs it: the device's own message."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShutdownView(View):
    """The instrument is switching off. ``reason`` is the alert that forced it, ``None`` after the diver's wish."""

    reason: Alert | None = None
    saving: bool = False
    """A save is still being finished."""


AnyView = (
    BootView
    | AimView
    | CaptureView
    | ReconstructView
    | ReviewView
    | SavingView
    | CalibrateView
    | FaultView
    | ShutdownView
)
