"""Vocabulary of the rig file: its tables and keys, their units and their allowed ranges.

Ranges are written once, here, and quoted by the error messages. They are the limits of the part in question
(board: ``docs/protocols/board.md``) or are physically sensible; no default of the optics is in here.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, ConfigDict, Field, Strict
from pydantic.dataclasses import dataclass

from appliance.measure import STANDARD
from drivers.camera_families import USUAL

# A misspelt key must not pass for a default, and TOML has words for inf and nan, which lie within no range.
_CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False)

# A number with a fraction; whole numbers are accepted, text and booleans are not.
_Real = Annotated[float, Strict()]
_Whole = Annotated[int, Strict()]
_Text = Annotated[str, Strict(), Field(min_length=1)]


def _path(value: object) -> object:
    if isinstance(value, Path):
        return value
    if not isinstance(value, str) or not value:
        raise ValueError("a path in quotes is needed")
    return Path(value)


@dataclass(frozen=True, slots=True, config=_CONFIG)
class Identity:
    """``[rig]``: name and serial number of this instrument, and its wires (``docs/protocols/wires.md``)."""

    name: _Text
    serial: _Text
    wires: Annotated[str, Strict(), Field(pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$")]
    wires_options: Mapping[str, Any] = field(default_factory=dict, hash=False)
    """Options that only the function that ``wires`` names reads."""


@dataclass(frozen=True, slots=True, config=_CONFIG)
class CameraRig:
    """``[camera.left]`` and ``[camera.right]``."""

    serial: _Text
    width_px: Annotated[_Whole, Field(ge=64, le=8192)]
    height_px: Annotated[_Whole, Field(ge=64, le=8192)]
    # Limits of this key alone; whether the exposure ends before the next vsync depends on two others (`checks`).
    exposure_ms: Annotated[_Real, Field(ge=0.05, le=16.6)]
    """Exposure: at most one period of the 60 Hz projector."""
    gain_db: Annotated[_Real, Field(ge=0.0, le=48.0)]
    full_well_e: Annotated[_Real, Field(ge=500.0, le=1e6)] = 13_000.0
    """Electrons at 255 grey values and 0 dB, from the data sheet (EMVA 1288: saturation capacity): makes each point's
    expected error."""
    read_noise_e: Annotated[_Real, Field(ge=0.0, le=1000.0)] = 20.0
    """Read noise from the data sheet (EMVA 1288: temporal dark noise)."""
    black_level_dn: Annotated[_Real, Field(ge=0.0, le=64.0)] = 2.0
    """Grey value of no light."""
    firmware: _Text | None = None
    """The version that this instrument was tested with; another one is named by ``kingfisher check``."""
    trigger_source: _Text | None = None
    """Input that the board's trigger line is wired to, as the camera calls it; ``None``: the first line that it offers.
    """
    pixel_format: Literal["Mono8", "Mono10", "Mono10p", "Mono10Packed", "Mono12", "Mono12p", "Mono12Packed"] = "Mono8"
    """Format on the wire; of more than 8 bits the upper 8 are used."""
    offset_x_px: Annotated[_Whole, Field(ge=0, le=8192)] | None = None
    """First column on the sensor; ``None``: the image lies in its middle."""
    offset_y_px: Annotated[_Whole, Field(ge=0, le=8192)] | None = None
    features: Mapping[str, bool | int | float | str] = field(default_factory=dict, hash=False)
    """Settings of this maker's cameras by their names, in order (``drivers.camera.setup``); a leading ``?``: may be
    missing."""


@dataclass(frozen=True, slots=True, config=_CONFIG)
class Cameras:
    left: CameraRig
    right: CameraRig
    kind: _Text = USUAL
    """The family of both (``drivers.camera_families``)."""


@dataclass(frozen=True, slots=True, config=_CONFIG)
class BoardRig:
    """``[board]``: the trigger board; ranges of the ARM and LIVE commands."""

    url: _Text
    """Anything pyserial opens: a device node or a URL."""
    trigger_delay_us: Annotated[_Whole, Field(ge=0, le=15000)]
    live_every_vsyncs: Annotated[_Whole, Field(ge=1, le=60)]
    firmware: _Text | None = None
    """The version that this instrument was tested with; another one is named by ``kingfisher check``."""
    vendor_id: Annotated[_Whole, Field(ge=0, le=0xFFFF)] = 0x1209
    """USB identity, which is written into the firmware and into the udev rules."""
    product_id: Annotated[_Whole, Field(ge=0, le=0xFFFF)] = 0x4B42


@dataclass(frozen=True, slots=True, config=_CONFIG)
class KeysRig:
    """``[keys]``: the keypad's USB identity, for firmware, udev rules, driver and safe screen."""

    vendor_id: Annotated[_Whole, Field(ge=0, le=0xFFFF)]
    product_id: Annotated[_Whole, Field(ge=0, le=0xFFFF)]
    firmware: _Text | None = None
    """The version that this instrument was tested with; another one is named by ``kingfisher check``."""


@dataclass(frozen=True, slots=True, config=_CONFIG)
class OutputRig:
    """``[projector]``, and most of ``[display]``: a connector of a graphics card, or a window on a desk."""

    kind: Literal["kms", "window"]
    width_px: Annotated[_Whole, Field(ge=64, le=8192)]
    height_px: Annotated[_Whole, Field(ge=64, le=8192)]
    refresh_hz: Annotated[_Real, Field(ge=1.0, le=240.0)]
    card: _Text | None = None
    connector: _Text | None = None


@dataclass(frozen=True, slots=True, config=_CONFIG)
class ProjectorRig(OutputRig):
    latency_blanks: Annotated[_Whole, Field(ge=0, le=5)] = 0
    """Vertical blanks from a flip until the projector throws its picture: controllers that buffer a frame show it one
    later."""
    light_begins_us: Annotated[_Whole, Field(ge=0, le=15000)] = 0
    """Time from that blank until its light begins, where the light goes on beyond the next blank."""
    channels: Literal["green", "all"] = "green"
    """Channels that a picture is drawn into: a projector that shows red, green and blue with one lamp gets the same in
    all."""
    sub_frames: Annotated[_Whole, Field(ge=1, le=8)] = 1
    """Equal sub-frames that a frame's light consists of; only whole ones give every grey its weight."""

    sync: Literal["negative", "positive"] | None = None
    """Polarity of the vertical sync that the board taps; ``None``: that of the published timing of the mode."""

    @property
    def sub_frame_ms(self) -> float:
        """Duration of a sub-frame."""
        return 1000.0 / self.refresh_hz / self.sub_frames


@dataclass(frozen=True, slots=True, config=_CONFIG)
class DisplayRig(OutputRig):
    language: Literal["en", "de"] = "en"
    """Language of all texts for the diver."""


_ExposureMs = Annotated[_Real, Field(ge=0.05, le=16.6)]


@dataclass(frozen=True, slots=True, config=_CONFIG)
class ScanRig:
    period_px: Literal[16, 32, 64]
    shortest_exposure_ms: Annotated[_Real, Field(ge=0.05, le=10.0)] = 2.0
    """Shortest exposure that the instrument may propose to the diver."""
    longest_exposure_ms: Annotated[_Real, Field(ge=2.0, le=16.6)] = 16.0
    """Longest exposure that the instrument may propose, and not beyond the projector's period."""
    most_gain_db: Annotated[_Real, Field(ge=0.0, le=48.0)] = 12.0
    """Largest gain that may be proposed, and only where the longest exposure is not enough, or between exposures far
    apart."""
    exposures_ms: Annotated[tuple[_ExposureMs, ...], Field(min_length=1, max_length=32)] | None = None
    """The only exposures that may be proposed, as ``kingfisher calibration measure exposures`` finds them;
    ``None``: the usual steps."""


@dataclass(frozen=True, slots=True, config=_CONFIG)
class WaterRig:
    """``[water]``: the inputs of the refractive index (Quan and Fry 1995, valid 400 to 700 nm)."""

    salinity_psu: Annotated[_Real, Field(ge=0.0, le=45.0)]
    temperature_c: Annotated[_Real, Field(ge=-2.0, le=40.0)]
    wavelength_nm: Annotated[_Real, Field(ge=400.0, le=700.0)]


@dataclass(frozen=True, slots=True, config=_CONFIG)
class StorageRig:
    root: Annotated[Path, BeforeValidator(_path)]
    reserve_mb: Annotated[_Whole, Field(ge=0, le=1_000_000)] = 500
    """Space that scans never use, so that logs, updates and the save in progress always fit."""
    keep_incomplete: bool = False
    """Keep the frames of a scan that broke off after its first direction, apart from the scans
    (``store/incomplete.py``)."""


@dataclass(frozen=True, slots=True, config=_CONFIG)
class DesignRig:
    """``[design]``: the nominal values, for a first calibration before the instrument was measured."""

    principal_distance_mm: Annotated[_Real, Field(ge=1.0, le=500.0)]
    pixel_um: Annotated[_Real, Field(ge=0.5, le=100.0)]
    baseline_mm: Annotated[_Real, Field(ge=10.0, le=2000.0)]
    toe_in_deg: Annotated[_Real, Field(ge=-45.0, le=45.0)]
    port_distance_mm: Annotated[_Real, Field(ge=0.0, le=500.0)]
    port_thickness_mm: Annotated[_Real, Field(ge=0.0, le=50.0)]
    port_index: Annotated[_Real, Field(ge=1.0, le=3.0)]
    projector_principal_distance_mm: Annotated[_Real, Field(ge=1.0, le=500.0)]
    projector_pixel_um: Annotated[_Real, Field(ge=0.5, le=100.0)]


@dataclass(frozen=True, slots=True, config=_CONFIG)
class VolumeRig:
    """``[volume]`` (optional): the distances between which the housing measures.

    They are along its axis from between the projection centres; by default those of the standard housing.
    """

    nearest_mm: Annotated[_Real, Field(ge=50.0, le=3000.0)] = STANDARD.nearest_mm
    working_mm: Annotated[_Real, Field(ge=50.0, le=3000.0)] = STANDARD.working_mm
    """Distance at which the diver should scan; other lengths of the housing scale with it."""
    farthest_mm: Annotated[_Real, Field(ge=50.0, le=3000.0)] = STANDARD.farthest_mm


@dataclass(frozen=True, slots=True, config=_CONFIG)
class LasersRig:
    """``[lasers]`` (optional): the nominal laser pointers, in the rig frame.

    The left one mirrors the right one. Their beams are learned from the dots; until then they are searched within the
    tolerance.
    """

    x_mm: Annotated[_Real, Field(ge=0.0, le=500.0)]
    y_mm: Annotated[_Real, Field(ge=-500.0, le=500.0)]
    z_mm: Annotated[_Real, Field(ge=-200.0, le=300.0)]
    """Place where the right beam leaves its window."""
    aim_x_mm: Annotated[_Real, Field(ge=0.0, le=200.0)]
    aim_y_mm: Annotated[_Real, Field(ge=-200.0, le=200.0)]
    aim_z_mm: Annotated[_Real, Field(ge=50.0, le=3000.0)]
    """A point of the right beam in the middle of the volume."""
    tolerance_deg: Annotated[_Real, Field(ge=0.01, le=1.0)] = 0.3
    """Standard deviation of a beam's angle from the nominal one, to each side."""


@dataclass(frozen=True, slots=True, config=_CONFIG)
class LimitsRig:
    """``[limits]`` (optional): temperatures and voltages at which the instrument protects itself.

    Defaults are cautious, to be set per housing.
    """

    case_warm_c: Annotated[_Real, Field(ge=0.0, le=100.0)] = 50.0
    case_hot_c: Annotated[_Real, Field(ge=0.0, le=100.0)] = 60.0
    case_off_c: Annotated[_Real, Field(ge=0.0, le=110.0)] = 68.0
    """Temperature from which the instrument switches itself off."""
    projector_warm_c: Annotated[_Real, Field(ge=0.0, le=120.0)] = 65.0
    projector_hot_c: Annotated[_Real, Field(ge=0.0, le=120.0)] = 75.0
    projector_off_c: Annotated[_Real, Field(ge=0.0, le=130.0)] = 85.0
    supply_low_v: Annotated[_Real, Field(ge=0.0, le=60.0)] | None = None
    """Voltage below which the supply is low; ``None``: the supply is not judged."""


@dataclass(frozen=True, slots=True, config=_CONFIG)
class BallBarRig:
    """``[ball_bar]`` (optional): the certificate of the bar that calibrates this instrument in water.

    Standard deviations are standard uncertainties: half of the expanded ones (k = 2) that certificates give.
    """

    length_mm: Annotated[_Real, Field(ge=20.0, le=1000.0)]
    """Distance between the centres of the balls."""
    length_sd_mm: Annotated[_Real, Field(ge=0.0001, le=1.0)]
    radius_mm: Annotated[_Real, Field(ge=5.0, le=40.0)]
    """Radius of both balls."""
    radius_sd_mm: Annotated[_Real, Field(ge=0.0001, le=1.0)]


@dataclass(frozen=True, slots=True, config=_CONFIG)
class Rig:
    """One instrument, as its rig file describes it.

    Checked when built: see ``appliance.store.config.checks``.
    """

    rig: Identity
    camera: Cameras
    board: BoardRig
    keys: KeysRig
    projector: ProjectorRig
    display: DisplayRig
    scan: ScanRig
    water: WaterRig
    storage: StorageRig
    design: DesignRig
    volume: VolumeRig = field(default_factory=VolumeRig)
    limits: LimitsRig = field(default_factory=LimitsRig)
    lasers: LasersRig | None = None
    """Laser pointers; ``None``: none are fitted, and no distance is shown."""
    ball_bar: BallBarRig | None = None
    """Bar for calibrations in water; ``None``: without a certificate the instrument cannot be calibrated in water."""

    @property
    def rig_hash(self) -> str:
        """sha256 (hex) of the content; comments, order and spelling of numbers do not count."""
        return _sha256(asdict(self))

    @property
    def optical_hash(self) -> str:
        """sha256 (hex) of the keys that bind a calibration: instrument, cameras, image sizes and raster.

        Unlike ``rig_hash`` it survives a changed exposure, salinity or folder.
        """
        return _sha256(
            {
                "rig": self.rig.serial,
                "cameras": [
                    # Only offsets that the file names, so that files without them keep their hash.
                    [c.serial, c.width_px, c.height_px, *(o for o in (c.offset_x_px, c.offset_y_px) if o is not None)]
                    for c in (self.camera.left, self.camera.right)
                ],
                "projector": [self.projector.width_px, self.projector.height_px],
            }
        )


def _sha256(content: object) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False, default=str)
    return hashlib.sha256(text.encode()).hexdigest()
