"""Owns what a screen can show: one frozen value per screen, complete in itself, in physical units.

A view says what is so; it holds no position, no colour and no words of its own. ``None`` is "not known" and is drawn
as a dash, never as zero.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from appliance.calibrate import Session, Step
from appliance.instrument.machine.alerts import Alert
from appliance.instrument.machine.guiding import GuidanceSaid, OverlapSaid
from appliance.instrument.machine.states import Calibrating
from appliance.instrument.machine.words import Label, Text
from appliance.instrument.ranging.marks import Marks
from appliance.instrument.ranging.reach import Reach
from appliance.measure import STANDARD, Grade, WorkingVolume
from drivers.api import Key

KeyLabels = Mapping[Key, Label]
"""The present meaning of each key. A key without a label has none drawn."""


def labels(
    scan: Text | None = None, back: Text | None = None, up: Text | None = None, down: Text | None = None
) -> KeyLabels:
    """Return the labels of the keys that mean something on a screen."""
    given = {Key.SCAN: scan, Key.BACK: back, Key.UP: up, Key.DOWN: down}
    return MappingProxyType({key: text for key, text in given.items() if text is not None})


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """Base of all views: alerts, the gravest first, and the meaning of the keys."""

    moves: ClassVar[bool] = True
    """False: nothing on it moves by itself but an alert that flashes; its drawing is not told the time."""
    alerts: tuple[Alert, ...] = ()
    keys: KeyLabels = field(default_factory=labels)


class DeviceResult(Enum):
    WAITING = "waiting"
    WORKS = "works"
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class DeviceLine:
    """One device of the self-test, named as in the rig file; ``detail`` is one short line, or empty: of an alert what
    to do."""

    device: str
    result: DeviceResult
    detail: Alert | Label = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BootView(View):
    """Start-up: each device with its result, as soon as it is known. Up to nine lines fit."""

    devices: tuple[DeviceLine, ...]
    version: str
    keys: KeyLabels = field(default_factory=lambda: labels(back=Text.HOLD_OFF))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SelfTestView(View):
    """Each device, and storage, calibration and worker, with its result. Up to nine lines fit."""

    devices: tuple[DeviceLine, ...]
    version: str
    finished: bool
    passed: bool
    """True if every line says OK; it means nothing before ``finished``. What failed need not forbid a scan."""
    keys: KeyLabels = field(default_factory=lambda: labels(back=Text.HOLD_OFF))


@dataclass(frozen=True, slots=True)
class Gauge:
    """Distance and tilt of the object, from the laser dots, and what to do about them."""

    distance_mm: float | None
    tilt_deg: float | None
    """Positive where the right side of the surface is farther away."""
    word: Reach
    volume: WorkingVolume = STANDARD
    """Range in which the housing measures."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AimView(View):
    """Live pictures while the diver chooses the place. A picture is (h, w) uint8; ``None`` is a camera without one."""

    moves: ClassVar[bool] = False
    left: NDArray[np.uint8] | None
    right: NDArray[np.uint8] | None
    scans_taken: int
    scans_left: int | None
    temperature_c: float | None
    exposure: str | None = None
    """Exposure of the next scan, with its unit; ``None``: there is nothing to say of it."""
    gauge: Gauge | None = None
    """Reading of the laser dots; ``None`` while the lasers are off."""
    marks: Marks | None = None
    """Places where the laser dots are going to be seen; ``None``: no marks are drawn."""
    water: Text | None = None
    """Word for the water that the refractive index is computed for."""
    overlap: OverlapSaid | None = None
    """Words about the overlap of the latest scan with the one before; ``None``: nothing is said."""
    guidance: GuidanceSaid | None = None
    """Words about the overlap that a scan from here would have, and the way to a better one, in place of ``overlap``;
    ``None``: nothing is said."""
    object: int | None = None
    """Number of the object that scans belong to; ``None``: of none."""
    scan_allowed: bool = True
    """False draws the label of SCAN dim; the reason is an alert."""
    keys: KeyLabels = field(default_factory=lambda: labels(scan=Text.SCAN, back=Text.HOLD_OFF))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmedView(View):
    """SCAN was pressed; lasers are proven off and cameras made ready. Nothing shines yet."""

    moves: ClassVar[bool] = False
    keys: KeyLabels = field(default_factory=lambda: labels(back=Text.STOP))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CaptureView(View):
    """The sequence is being recorded. Drawn once, before the first pattern: until the last one nothing is drawn."""

    moves: ClassVar[bool] = False
    keys: KeyLabels = field(default_factory=lambda: labels(back=Text.STOP))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CheckView(View):
    """The sequence is recorded; whether its frames show what they should is being checked. The diver may move."""

    keys: KeyLabels = field(default_factory=lambda: labels(back=Text.HOLD_REDO))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReconstructView(View):
    """Points are being computed; for how long, nobody knows."""

    keys: KeyLabels = field(default_factory=lambda: labels(back=Text.HOLD_REDO))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReviewView(View):
    """A scan and its verdict. The coarse cloud comes first; the full one replaces it in a later view.

    ``points_mm`` is (n, 3) float32 in the left camera frame, ``values`` (n,) float32 their distance in mm, which is
    what the colours mean. The arrays must not change while they are shown; the same memory in the next view is not
    copied again. No points: (0, 3), (0,).
    """

    points_mm: NDArray[np.float32]
    values: NDArray[np.float32]
    coarse: bool
    grade: Grade
    points: int
    coverage_percent: float | None
    noise_mm: float | None
    distance_mm: float | None
    duration_s: float | None
    """Time in seconds from the key press to this picture; ``None`` where it is not known."""
    lengths_doubtful: bool = False
    """Lengths are not to be trusted: no grade stands alone."""
    overlap: OverlapSaid | None = None
    """Words about the overlap with the scan before; ``None``: nothing is said."""
    next_scan: str | None = None
    """Exposure of the next scan, with its unit, where it is not that of this one."""
    turn: int = 0
    """Number of steps by which the diver turned the cloud: to the right."""
    keys: KeyLabels = field(default_factory=lambda: labels(scan=Text.KEEP, back=Text.HOLD_REDO, up=Text.TURN))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SavingView(View):
    """A scan on its way to the disk. ``saved`` is a promise: set it after the last fsync, not before."""

    scan_id: str
    saved: bool


@dataclass(frozen=True, slots=True)
class MenuRow:
    """One line of a menu. ``value`` is what is chosen now, in one word or several."""

    text: Text
    value: Label = ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MenuView(View):
    """A page of the menu. Any number of rows: those around the selected one are shown."""

    moves: ClassVar[bool] = False
    title: Text
    rows: tuple[MenuRow, ...]
    selected: int
    changing: bool = False
    """The value of the selected row is being changed, and not yet taken."""
    keys: KeyLabels = field(
        default_factory=lambda: labels(scan=Text.OK, back=Text.BACK, up=Text.ARROW_UP, down=Text.ARROW_DOWN)
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GalleryView(View):
    """One scan on the disk, ``index`` (from 0, the newest first) of ``count``; ``count`` 0 is an empty gallery.

    ``preview`` is (h, w, 3) uint8 RGB as it was stored, and must not change while it is shown. ``taken`` is the wall
    time as text, ``None`` where the clock was not to be trusted. Of a ``damaged`` scan the rest may be unknown.
    """

    moves: ClassVar[bool] = False
    scan_id: str = ""
    index: int = 0
    count: int = 0
    preview: NDArray[np.uint8] | None = None
    grade: Grade | None = None
    corrected: bool = False
    """True if motion was taken out of its points."""
    lengths_doubtful: bool = False
    """True if lengths were not to be trusted when the scan was taken."""
    points: int | None = None
    coverage_percent: float | None = None
    noise_mm: float | None = None
    distance_mm: float | None = None
    taken: str | None = None
    damaged: bool = False
    keys: KeyLabels = field(default_factory=lambda: labels(back=Text.BACK, up=Text.NEWER, down=Text.OLDER))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CalibrateView(View):
    """One step of the calibration: what to hold and how, the live pictures, and what became of the latest recording."""

    at: Calibrating
    session: Session
    left: NDArray[np.uint8] | None
    right: NDArray[np.uint8] | None
    scan_allowed: bool = True
    """False draws the label of SCAN dim, like in ``AimView``; it means something only at the steps that record."""
    gauge: Gauge | None = None
    """Reading of the laser dots, drawn like that of ``AimView``, and so are the marks."""
    marks: Marks | None = None
    volume: WorkingVolume = STANDARD
    """Range in which the housing measures: where planes are to be held."""

    @property
    def step(self) -> Step:
        """The step that is shown."""
        return self.at.step


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CoolingView(View):
    """Too hot to shine: dark until ``temperature_c`` has fallen to ``limit_c``."""

    moves: ClassVar[bool] = False
    temperature_c: float | None
    limit_c: float
    remaining_s: float | None
    """Estimated time in seconds until it is that cool; ``None`` where it cannot be told."""
    keys: KeyLabels = field(default_factory=lambda: labels(back=Text.BACK))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SafeView(View):
    """No light any more: ``alert`` says why, and what to do. ``saved``: every scan is durable on the disk."""

    alert: Alert
    saved: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ShutdownView(View):
    """The instrument is switching off. ``reason`` is the alert that forced it, ``None`` after the diver's wish."""

    reason: Alert | None = None
    saving: bool = False
    """A save is still being finished."""


AnyView = (
    BootView
    | SelfTestView
    | AimView
    | ArmedView
    | CaptureView
    | CheckView
    | ReconstructView
    | ReviewView
    | SavingView
    | MenuView
    | GalleryView
    | CalibrateView
    | CoolingView
    | SafeView
    | ShutdownView
)
