"""Reading USB descriptors: which device is a USB3 Vision camera, and which are its pipes."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from drivers.camera import u3v


class MalformedDescriptor(ValueError):
    """The bytes are not the descriptor they claim to be."""


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """The U3V device-info descriptor (USB3 Vision 1.0, table 3-6). Strings are indices; 0 means none."""

    gencp_version: tuple[int, int]
    u3v_version: tuple[int, int]
    guid_index: int
    vendor_index: int
    model_index: int
    family_index: int
    device_version_index: int
    manufacturer_info_index: int
    serial_index: int
    user_name_index: int
    speed_mask: int


def parse_device_info(data: bytes) -> DeviceInfo:
    """Parse the 20 bytes of a U3V device-info descriptor. Raises MalformedDescriptor."""
    if len(data) < u3v.DEVICE_INFO_LENGTH or data[0] < u3v.DEVICE_INFO_LENGTH:
        raise MalformedDescriptor(f"device info of {len(data)} bytes; the standard says {u3v.DEVICE_INFO_LENGTH}")
    if (data[1], data[2]) != (u3v.DEVICE_INFO_DESCRIPTOR_TYPE, u3v.DEVICE_INFO_DESCRIPTOR_SUBTYPE):
        raise MalformedDescriptor(f"descriptor type {data[1]:#04x}/{data[2]:#04x} is not a U3V device info (0x24/0x01)")
    gencp_minor, gencp_major, u3v_minor, u3v_major = struct.unpack_from("<4H", data, 3)
    return DeviceInfo((gencp_major, gencp_minor), (u3v_major, u3v_minor), *data[11:20])


def find_device_info(extra: bytes) -> DeviceInfo | None:
    """Return the first U3V device info in a chain of class-specific descriptors, or ``None``.

    Never raises: bytes that do not chain end the search.
    """
    offset = 0
    while offset + 3 <= len(extra):
        length = extra[offset]
        if length < 3 or offset + length > len(extra):
            return None
        piece = extra[offset : offset + length]
        kind = (piece[1], piece[2])
        if (
            kind == (u3v.DEVICE_INFO_DESCRIPTOR_TYPE, u3v.DEVICE_INFO_DESCRIPTOR_SUBTYPE)
            and length >= u3v.DEVICE_INFO_LENGTH
        ):
            return parse_device_info(piece)
        offset += length
    return None


def parse_string(data: bytes) -> str:
    """Return the text of a USB string descriptor (USB 2.0, 9.6.7: length, type 3, UTF-16LE).

    Raises MalformedDescriptor.
    """
    if len(data) < 2 or data[1] != 0x03 or data[0] < 2 or data[0] > len(data):
        raise MalformedDescriptor(f"not a string descriptor: {data[:4].hex(' ')}")
    return data[2 : data[0]].decode("utf-16-le", errors="replace").rstrip("\0")


@dataclass(frozen=True, slots=True)
class InterfaceDescription:
    """One interface of a configuration, reduced to the fields with which its pipes are found."""

    number: int
    interface_class: int
    interface_subclass: int
    protocol: int
    bulk_in: tuple[int, ...]
    bulk_out: tuple[int, ...]
    extra: bytes


@dataclass(frozen=True, slots=True)
class U3vLayout:
    """The pipes of a USB3 Vision device."""

    configuration: int
    control_interface: int
    control_in: int
    control_out: int
    stream_interface: int
    stream_in: int
    info: DeviceInfo | None


def find_layout(configuration: int, interfaces: list[InterfaceDescription]) -> U3vLayout | None:
    """Find control and stream among the interfaces; ``None`` when this is no USB3 Vision device."""
    control: InterfaceDescription | None = None
    stream: InterfaceDescription | None = None
    for interface in interfaces:
        if (interface.interface_class, interface.interface_subclass) != (u3v.USB_CLASS_MISCELLANEOUS, u3v.U3V_SUBCLASS):
            continue
        if interface.protocol == u3v.PROTOCOL_CONTROL and interface.bulk_in and interface.bulk_out:
            control = control or interface
        elif interface.protocol == u3v.PROTOCOL_STREAM and interface.bulk_in:
            stream = stream or interface
    if control is None or stream is None:
        return None
    return U3vLayout(
        configuration=configuration,
        control_interface=control.number,
        control_in=control.bulk_in[0],
        control_out=control.bulk_out[0],
        stream_interface=stream.number,
        stream_in=stream.bulk_in[0],
        info=find_device_info(control.extra),
    )
