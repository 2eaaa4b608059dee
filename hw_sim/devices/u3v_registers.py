"""The camera's register map: the tables of GenCP and USB3 Vision, and the camera's features.

The addresses of the features are only in this file and in ``u3v_camera.xml``, which the camera hands out.
"""

from __future__ import annotations

import hashlib
import io
import struct
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib import resources
from typing import Protocol

from hw_sim.devices import feature_registers, feature_xml, u3v_control
from hw_sim.devices.feature_book import FeatureBook
from hw_sim.devices.gencp_memory import AccessError, Memory, Register, Status
from hw_sim.devices.power_on import PowerOn
from hw_sim.devices.shutter import (
    AUTO_CONTINUOUS,
    AUTO_OFF,
    FALLING,
    LINE0,
    MULTI_FRAME,
    RISING,
    SOFTWARE,
    TIMED,
    TRIGGER_WIDTH,
    Settings,
)
from hw_sim.devices.u3v_descriptors import GENCP_VERSION, U3V_VERSION, Identity, Speed
from hw_sim.devices.u3v_stream import LEADER_BYTES, MONO8, Region, Setup, StreamRules

MAKERS_FEATURES = 0x20_1000
MANIFEST, SBRM, SIRM, EIRM, FEATURES, XML = 0x8000, 0x1_0000, 0x1_1000, 0x1_2000, 0x20_0000, 0x80_0000
FIRMWARE_VERSION = "1.2.0"
ACQUISITION_START, ACQUISITION_STOP = FEATURES + 0x104, FEATURES + 0x108
TIMESTAMP_INCREMENT_NS = 8
_USER_NAME_BYTES = 64
_BUS_SPEED = {Speed.HIGH: 4, Speed.SUPER: 8}
_XML_VERSION = (1, 2, 0)
_XML_TIME = (2024, 5, 14, 9, 0, 0)


class CameraCore(Protocol):
    """The part of a camera that its registers read and change."""

    identity: Identity
    power_on: PowerOn
    speed: Speed
    setup: Setup
    region: Region
    sensor: tuple[int, int]
    user_name: bytes
    streaming: bool
    once_enabled: bool
    book: FeatureBook | None
    rules: StreamRules

    @property
    def settings(self) -> Settings: ...

    @property
    def acquiring(self) -> bool: ...

    def stream(self, on: bool) -> None: ...

    def clock_ns(self) -> int: ...

    def temperature_c(self) -> float: ...

    def start(self) -> None: ...

    def stop(self) -> None: ...

    def software_trigger(self) -> None: ...

    def trigger_mode_changed(self) -> None: ...

    def features_changed(self, name: str) -> None: ...

    def restart(self) -> None: ...


@dataclass(frozen=True, slots=True)
class Limits:
    """Allowed values of a register."""

    low: int
    high: int
    step: int = 1

    def check(self, value: int) -> None:
        """Check a value. Raises AccessError."""
        if not self.low <= value <= self.high or (value - self.low) % self.step:
            raise AccessError(Status.INVALID_PARAMETER)


def zipped_description(lacks: tuple[str, ...] = ()) -> bytes:
    """Return the GenICam description as the camera stores it: the same bytes every time.

    The features in ``lacks`` have a maker's name, as in cameras that do not follow the naming convention.
    """
    return _zipped(_without(resources.files(__package__).joinpath("u3v_camera.xml").read_bytes(), lacks), "KFC1920")


def _without(xml: bytes, lacks: tuple[str, ...]) -> bytes:
    for name in lacks:
        for before, after in (('Name="%s"', 'Name="Maker%s"'), ("<pFeature>%s<", "<pFeature>Maker%s<")):
            xml = xml.replace((before % name).encode(), (after % name).encode())
        xml = xml.replace(b"<pSelected>%s<" % name.encode(), b"<pSelected>Maker%s<" % name.encode())
    return xml


def _zipped(xml: bytes, model: str) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(zipfile.ZipInfo(f"Kingfisher_{model}.xml", _XML_TIME), xml, zipfile.ZIP_DEFLATED)
    return packed.getvalue()


def build(core: CameraCore) -> Memory:
    """Return all memory of a camera."""
    memory = Memory()
    book = core.book
    if book is None:
        description = zipped_description(core.power_on.lacks)
    else:
        xml = feature_xml.description(book.maker, MAKERS_FEATURES)
        description = _zipped(_without(xml, core.power_on.lacks), book.maker.family.replace(" ", ""))
    _bootstrap(memory, core)
    _manifest(memory, description)
    _technology(memory, core)
    _stream_interface(memory, core)
    _event_interface(memory)
    if book is None:
        _features(memory, core)
    else:
        feature_registers.lay_out(memory, book, core, MAKERS_FEATURES)
    _own_registers(memory, core)
    memory.blob(XML, description + bytes(-len(description) % 4))
    return memory


def start_address(book: FeatureBook | None) -> int:
    """Return the address of AcquisitionStart."""
    return ACQUISITION_START if book is None else feature_xml.addresses(book.maker, MAKERS_FEATURES)["AcquisitionStart"]


def _version(version: tuple[int, int]) -> int:
    major, minor = version
    return major << 16 | minor


def _bootstrap(memory: Memory, core: CameraCore) -> None:
    """Lay out the ABRM (technology-agnostic bootstrap registers).

    User name, timestamp, family name, SBRM and the written length are supported.
    """
    identity = core.identity
    # GenCP 1.3 prescribes these addresses of the ABRM.
    memory.u32(0x000, lambda: _version(GENCP_VERSION))
    texts = (identity.vendor, identity.model, identity.family, identity.version, identity.info, identity.serial)
    for index, text in enumerate(texts):
        memory.text(0x004 + 64 * index, 64, text)

    def rename(data: bytes) -> None:
        core.user_name = data.ljust(_USER_NAME_BYTES, b"\0")

    memory.add(Register(0x184, _USER_NAME_BYTES, lambda: core.user_name, rename, is_number=False))
    # Device capability: one bit for each supported function.
    memory.u64(0x1C4, lambda: 1 << 0 | 1 << 3 | 1 << 8 | 1 << 9 | 1 << 11)
    memory.u32(0x1CC, lambda: u3v_control.MAX_RESPONSE_MS)
    memory.u64(0x1D0, lambda: MANIFEST)
    memory.u64(0x1D8, lambda: SBRM)
    memory.u64(0x1E0, lambda: 0)
    latched = 0

    def latch(value: int) -> None:
        nonlocal latched
        if value & 1:
            latched = core.clock_ns()

    # The timestamp is the last latched one, so that the two halves of a number belong together.
    memory.u64(0x1F0, lambda: latched)
    memory.u32(0x1F8, None, latch)
    memory.u64(0x1FC, lambda: TIMESTAMP_INCREMENT_NS)


def _manifest(memory: Memory, description: bytes) -> None:
    major, minor, sub = _XML_VERSION
    # GenCP 1.3, manifest entry: version of the file, schema and type (1 << 10: zipped), address, size, SHA-1.
    entry = struct.pack("<IIQQ", major << 24 | minor << 16 | sub, 1 << 24 | 1 << 16 | 1 << 10, XML, len(description))
    digest = hashlib.sha1(description, usedforsecurity=False).digest()
    memory.blob(MANIFEST, struct.pack("<Q", 1) + entry + digest + bytes(20))


def _technology(memory: Memory, core: CameraCore) -> None:
    """Lay out the SBRM (technology-specific bootstrap registers), with stream and event interfaces."""
    memory.u32(SBRM + 0x00, lambda: _version(U3V_VERSION))
    memory.u64(SBRM + 0x04, lambda: 1 << 0 | 1 << 1)
    memory.u64(SBRM + 0x0C, lambda: 0)
    memory.u32(SBRM + 0x14, lambda: u3v_control.MAX_COMMAND)
    memory.u32(SBRM + 0x18, lambda: u3v_control.MAX_ACKNOWLEDGE)
    memory.u32(SBRM + 0x1C, lambda: 1)
    memory.u64(SBRM + 0x20, lambda: SIRM)
    memory.u32(SBRM + 0x28, lambda: 0x30)
    memory.u64(SBRM + 0x2C, lambda: EIRM)
    memory.u32(SBRM + 0x34, lambda: 0x08)
    memory.u64(SBRM + 0x38, lambda: 0)
    memory.u32(SBRM + 0x40, lambda: _BUS_SPEED[core.speed])


def _stream_interface(memory: Memory, core: CameraCore) -> None:
    """Lay out the SIRM (stream interface registers): the set-up can only be written while the stream is off."""

    def field(name: str) -> tuple[Callable[[], int], Callable[[int], None]]:
        def write(value: int) -> None:
            if core.streaming:
                raise AccessError(Status.ACCESS_DENIED)
            setattr(core.setup, name, value)

        return lambda: int(getattr(core.setup, name)), write

    def control(value: int) -> None:
        core.stream(bool(value & 1))

    def required(size: Callable[[], int]) -> Callable[[], int]:
        return lambda: 0 if core.rules.sizes_once_enabled and not core.once_enabled else size()

    memory.u32(SIRM + 0x00, lambda: core.rules.alignment_log2 << 24)
    memory.u32(SIRM + 0x04, lambda: int(core.streaming), control)
    memory.u64(SIRM + 0x08, lambda: core.region.payload_bytes)
    memory.u32(SIRM + 0x10, required(lambda: LEADER_BYTES))
    memory.u32(SIRM + 0x14, required(lambda: core.region.trailer_bytes))
    for offset, name in (
        (0x18, "max_leader"),
        (0x1C, "size"),
        (0x20, "count"),
        (0x24, "final1"),
        (0x28, "final2"),
        (0x2C, "max_trailer"),
    ):
        memory.u32(SIRM + offset, *field(name))


def _event_interface(memory: Memory) -> None:
    """Lay out the EIRM (event interface registers): it may be enabled, but this camera has no events to send."""
    enabled = 0

    def control(value: int) -> None:
        nonlocal enabled
        enabled = value & 1

    memory.u32(EIRM + 0x00, lambda: enabled, control)
    memory.u32(EIRM + 0x04, lambda: 0)


def _features(memory: Memory, core: CameraCore) -> None:
    base = FEATURES
    sensor_width, sensor_height = core.sensor

    def shape(name: str, limits: Callable[[Region], Limits]) -> tuple[Callable[[], int], Callable[[int], None]]:
        """A property of the region; locked while frames may be on their way."""

        def write(value: int) -> None:
            if core.acquiring or core.streaming:
                raise AccessError(Status.ACCESS_DENIED)
            region = core.region
            limits(region).check(value)
            values = {key: getattr(region, key) for key in ("width", "height", "offset_x", "offset_y")}
            core.region = Region(**(values | {name: value}))

        return lambda: int(getattr(core.region, name)), write

    def width() -> tuple[Callable[[], int], Callable[[int], None]]:
        read, write = shape("width", lambda r: Limits(16, sensor_width - r.offset_x, 8))
        step = core.power_on.width_step_px or 1
        return read, lambda value: write(value // step * step)

    def manual(name: str, auto: str, limits: Limits) -> tuple[Callable[[], int], Callable[[int], None]]:
        """A value that only its automatic function may change while that is on."""
        read, write = setting(name, limits)

        def checked(value: int) -> None:
            if getattr(core.settings, auto) != AUTO_OFF:
                raise AccessError(Status.ACCESS_DENIED)
            write(value)

        return read, checked

    def setting(
        name: str, allowed: Limits | tuple[int, ...], locked: bool = False, then: Callable[[], None] | None = None
    ) -> tuple[Callable[[], int], Callable[[int], None]]:
        def write(value: int) -> None:
            if locked and core.acquiring:
                raise AccessError(Status.ACCESS_DENIED)
            if isinstance(allowed, Limits):
                allowed.check(value)
            elif value not in allowed:
                raise AccessError(Status.INVALID_PARAMETER)
            setattr(core.settings, name, value)
            if then is not None:
                then()

        return lambda: int(getattr(core.settings, name)), write

    def only(value: int) -> Callable[[int], None]:
        return Limits(value, value).check

    # The camera's own features; u3v_camera.xml names the same addresses.
    memory.u32(base + 0x000, *width())
    memory.u32(base + 0x004, *shape("height", lambda r: Limits(2, sensor_height - r.offset_y, 2)))
    memory.u32(base + 0x008, *shape("offset_x", lambda r: Limits(0, sensor_width - r.width, 8)))
    memory.u32(base + 0x00C, *shape("offset_y", lambda r: Limits(0, sensor_height - r.height, 2)))
    memory.u32(base + 0x010, lambda: MONO8, only(MONO8))
    memory.u32(base + 0x014, lambda: sensor_width)
    memory.u32(base + 0x018, lambda: sensor_height)
    memory.u32(base + 0x01C, lambda: core.region.payload_bytes)
    memory.u32(base + 0x020, lambda: sensor_width - core.region.offset_x)
    memory.u32(base + 0x024, lambda: sensor_height - core.region.offset_y)
    memory.u32(base + 0x100, *setting("acquisition_mode", Limits(0, MULTI_FRAME), locked=True))
    memory.u32(ACQUISITION_START, None, _command(core.start))
    memory.u32(ACQUISITION_STOP, None, _command(core.stop))
    memory.u32(base + 0x10C, *setting("frame_count", Limits(1, 65_535), locked=True))
    memory.u32(base + 0x110, *setting("frame_rate_mhz", Limits(1_000, 60_000)))
    memory.u32(base + 0x114, lambda: int(core.acquiring))
    memory.u32(base + 0x200, *setting("trigger_on", (0, 1), then=core.trigger_mode_changed))
    memory.u32(base + 0x204, *setting("trigger_source", (LINE0, SOFTWARE)))
    memory.u32(base + 0x208, *setting("trigger_activation", (RISING, FALLING)))
    memory.u32(base + 0x20C, None, _command(core.software_trigger))
    memory.u32(base + 0x210, lambda: 0, only(0))
    memory.u32(base + 0x300, *setting("exposure_mode", (TIMED, TRIGGER_WIDTH)))
    memory.u32(base + 0x304, *manual("exposure_us", "exposure_auto", Limits(20, 1_000_000)))
    memory.u32(base + 0x308, *manual("gain_tenth_db", "gain_auto", Limits(0, 240)))
    memory.u32(base + 0x30C, *setting("exposure_auto", (AUTO_OFF, AUTO_CONTINUOUS)))
    memory.u32(base + 0x310, *setting("gain_auto", (AUTO_OFF, AUTO_CONTINUOUS)))


def _own_registers(memory: Memory, core: CameraCore) -> None:
    """Lay out temperature, version and reset of every personality, as ``u3v_camera.xml`` names them."""
    memory.f32(FEATURES + 0x400, core.temperature_c)
    memory.text(FEATURES + 0x420, 32, FIRMWARE_VERSION)
    memory.u32(FEATURES + 0x500, None, _command(core.restart))


def _command(action: Callable[[], None]) -> Callable[[int], None]:
    def write(value: int) -> None:
        if value & 1:
            action()

    return write
