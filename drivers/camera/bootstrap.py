"""Reading the bootstrap registers: the camera's identity, and the addresses of its other registers."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from drivers.camera import u3v
from drivers.camera.control import ControlChannel


@dataclass(frozen=True, slots=True)
class Identification:
    """ABRM, parsed."""

    vendor: str
    model: str
    family: str
    firmware: str
    serial: str
    user_name: str
    max_response_time_s: float
    manifest_address: int
    sbrm_address: int


@dataclass(frozen=True, slots=True)
class Technology:
    """SBRM, parsed. ``link_speed_mbps`` is ``None`` for a code the standard does not list."""

    max_command_size: int
    max_answer_size: int
    stream_count: int
    sirm_address: int
    link_speed_mbps: int | None


@dataclass(frozen=True, slots=True)
class StreamNeeds:
    """Sizes in bytes that a stream needs now, from the SIRM."""

    alignment: int
    enabled: bool
    payload_size: int
    leader_size: int
    trailer_size: int


@dataclass(frozen=True, slots=True)
class ManifestEntry:
    """One file in the camera: its address, size and format."""

    file_version: int
    """Major in the upper byte, minor, subminor in the lower half: larger is newer."""
    file_format: int
    address: int
    size: int
    sha1: bytes | None
    """SHA-1 of the description; ``None`` where the camera gives none (all zeros)."""


def _text(data: bytes, offset: int) -> str:
    raw = data[offset : offset + u3v.ABRM_STRING_SIZE]
    return raw.split(b"\0", 1)[0].decode("utf-8", errors="replace").strip()


def parse_identification(data: bytes) -> Identification:
    """Parse the first 0x1E0 bytes of the ABRM. Raises ValueError when there are fewer."""
    if len(data) < u3v.ABRM_HEAD_SIZE:
        raise ValueError(f"{len(data)} bytes of ABRM, expected {u3v.ABRM_HEAD_SIZE}")
    (response_ms,) = struct.unpack_from("<I", data, u3v.ABRM_MAX_RESPONSE_TIME_MS)
    manifest, sbrm = struct.unpack_from("<QQ", data, u3v.ABRM_MANIFEST_ADDRESS)
    return Identification(
        vendor=_text(data, u3v.ABRM_MANUFACTURER_NAME),
        model=_text(data, u3v.ABRM_MODEL_NAME),
        family=_text(data, u3v.ABRM_FAMILY_NAME),
        firmware=_text(data, u3v.ABRM_DEVICE_VERSION),
        serial=_text(data, u3v.ABRM_SERIAL_NUMBER),
        user_name=_text(data, u3v.ABRM_USER_NAME),
        max_response_time_s=response_ms * 1e-3,
        manifest_address=manifest,
        sbrm_address=sbrm,
    )


def parse_technology(data: bytes) -> Technology:
    """Parse the first 0x44 bytes of the SBRM. Raises ValueError when there are fewer."""
    if len(data) < u3v.SBRM_SIZE:
        raise ValueError(f"{len(data)} bytes of SBRM, expected {u3v.SBRM_SIZE}")
    command, answer, streams = struct.unpack_from("<III", data, u3v.SBRM_MAX_COMMAND_SIZE)
    (sirm,) = struct.unpack_from("<Q", data, u3v.SBRM_SIRM_ADDRESS)
    (speed,) = struct.unpack_from("<I", data, u3v.SBRM_CURRENT_SPEED)
    return Technology(command, answer, streams, sirm, u3v.SPEED_MBPS_OF_SBRM.get(speed))


def parse_stream_needs(data: bytes) -> StreamNeeds:
    """Parse the first 0x18 bytes of the SIRM. Raises ValueError when there are fewer."""
    if len(data) < u3v.SIRM_REQUIREMENTS_SIZE:
        raise ValueError(f"{len(data)} bytes of SIRM, expected {u3v.SIRM_REQUIREMENTS_SIZE}")
    info, control, payload, leader, trailer = struct.unpack_from("<IIQII", data)
    return StreamNeeds(1 << (info >> 24 & 0x1F), bool(control & u3v.SIRM_ENABLE), payload, leader, trailer)


def parse_manifest_entry(data: bytes) -> ManifestEntry:
    """Parse one 64-byte manifest entry. Raises ValueError when there are fewer bytes."""
    if len(data) < u3v.MANIFEST_ENTRY_SIZE:
        raise ValueError(f"{len(data)} bytes of manifest entry, expected {u3v.MANIFEST_ENTRY_SIZE}")
    version, schema, address, size = struct.unpack_from("<IIQQ", data)
    sha1 = data[24:44]
    return ManifestEntry(version, schema >> 10 & 0x3F, address, size, sha1 if any(sha1) else None)


def read_identification(control: ControlChannel) -> Identification:
    """Read the camera's identity. Raises DeviceGone, ControlRefused."""
    return parse_identification(control.read(u3v.ABRM_GENCP_VERSION, u3v.ABRM_HEAD_SIZE))


def read_technology(control: ControlChannel, sbrm_address: int) -> Technology:
    """Read the limits of the control channel and the address of the stream registers."""
    return parse_technology(control.read(sbrm_address, u3v.SBRM_SIZE))


def read_stream_needs(control: ControlChannel, sirm_address: int) -> StreamNeeds:
    """Read the needs of a stream with the present image size."""
    return parse_stream_needs(control.read(sirm_address, u3v.SIRM_REQUIREMENTS_SIZE))
