"""Parsing of a device's descriptors into named fields, grouped as in libusb."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import Any

_FIELDS: dict[int, tuple[str, tuple[str, ...]]] = {
    1: (
        "<BBHBBBBHHHBBBB",
        (
            *("bLength", "bDescriptorType", "bcdUSB", "bDeviceClass", "bDeviceSubClass", "bDeviceProtocol"),
            *("bMaxPacketSize0", "idVendor", "idProduct", "bcdDevice", "iManufacturer", "iProduct"),
            *("iSerialNumber", "bNumConfigurations"),
        ),
    ),
    2: (
        "<BBHBBBBB",
        (
            *("bLength", "bDescriptorType", "wTotalLength", "bNumInterfaces", "bConfigurationValue"),
            *("iConfiguration", "bmAttributes", "bMaxPower"),
        ),
    ),
    4: (
        "<BBBBBBBBB",
        (
            *("bLength", "bDescriptorType", "bInterfaceNumber", "bAlternateSetting", "bNumEndpoints"),
            *("bInterfaceClass", "bInterfaceSubClass", "bInterfaceProtocol", "iInterface"),
        ),
    ),
    5: (
        "<BBBBHB",
        ("bLength", "bDescriptorType", "bEndpointAddress", "bmAttributes", "wMaxPacketSize", "bInterval"),
    ),
}
_CONFIGURATION, _INTERFACE, _ENDPOINT = 2, 4, 5


@dataclass(slots=True)
class Interface:
    """An interface's fields, and those of its endpoints."""

    fields: dict[str, Any]
    endpoints: list[dict[str, Any]] = field(default_factory=list)


def parse_device(raw: bytes) -> dict[str, Any]:
    """Return the fields of a device descriptor, by the names of the USB specification."""
    return _named(raw)


def parse_configuration(raw: bytes) -> tuple[dict[str, Any], list[Interface]]:
    """Return the fields of a configuration and its interfaces, by the names of the USB specification.

    Other descriptors go into ``extra_descriptors`` of the one before them.
    """
    configuration: dict[str, Any] = {}
    interfaces: list[Interface] = []
    latest: dict[str, Any] = {}
    offset = 0
    while offset < len(raw):
        # Every descriptor begins with its length and type, so that unknown ones can be skipped.
        length, kind = raw[offset], raw[offset + 1]
        piece = raw[offset : offset + length]
        offset += length
        if kind not in (_CONFIGURATION, _INTERFACE, _ENDPOINT):
            latest["extra_descriptors"] += list(piece)
            continue
        latest = {**_named(piece), "extra_descriptors": []}
        if kind == _CONFIGURATION:
            configuration = latest
        elif kind == _INTERFACE:
            interfaces.append(Interface(latest))
        else:
            interfaces[-1].endpoints.append({**latest, "bRefresh": 0, "bSynchAddress": 0})
            latest = interfaces[-1].endpoints[-1]
    return configuration, interfaces


def _named(raw: bytes) -> dict[str, Any]:
    form, names = _FIELDS[raw[1]]
    return dict(zip(names, struct.unpack(form, raw[: struct.calcsize(form)]), strict=True))
