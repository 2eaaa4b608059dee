"""The kernel's mode-setting structures and numbers (linux/drm.h, linux/drm_mode.h), little endian, 64 bit."""

from __future__ import annotations

import ctypes
import struct
from ctypes import c_char, c_int32, c_uint16, c_uint32, c_uint64

IOCTL_TYPE = ord("d")

VERSION, GET_CAP, SET_CLIENT_CAP, SET_MASTER, DROP_MASTER = 0x00, 0x0C, 0x0D, 0x1E, 0x1F
GETRESOURCES, GETCRTC, SETCRTC, GETENCODER, GETCONNECTOR = 0xA0, 0xA1, 0xA2, 0xA6, 0xA7
GETGAMMA, SETGAMMA = 0xA4, 0xA5
GETPROPERTY, SETPROPERTY, ADDFB, RMFB, PAGE_FLIP = 0xAA, 0xAB, 0xAE, 0xAF, 0xB0
DIRTYFB = 0xB1
CREATE_DUMB, MAP_DUMB, DESTROY_DUMB, OBJ_GETPROPERTIES, OBJ_SETPROPERTY = 0xB2, 0xB3, 0xB4, 0xB9, 0xBA

CAP_DUMB_BUFFER, CAP_VBLANK_HIGH_CRTC, CAP_DUMB_PREFERRED_DEPTH = 0x1, 0x2, 0x3
CAP_PREFER_SHADOW, CAP_PRIME, CAP_TIMESTAMP_MONOTONIC, CAP_ASYNC_PAGE_FLIP = 0x4, 0x5, 0x6, 0x7
CAP_CURSOR_WIDTH, CAP_CURSOR_HEIGHT, CAP_ADDFB2_MODIFIERS, CAP_CRTC_IN_VBLANK_EVENT = 0x8, 0x9, 0x10, 0x12

OBJECT_CRTC, OBJECT_CONNECTOR, OBJECT_ANY = 0xCCCCCCCC, 0xC0C0C0C0, 0
PROP_RANGE, PROP_ENUM = 1 << 1, 1 << 3
FLIP_EVENT = 0x01
EVENT_FLIP_COMPLETE = 0x02
CONNECTOR_DISPLAY_PORT, CONNECTOR_HDMI_A = 10, 11
CONNECTED = 1
SUBPIXEL_UNKNOWN = 1
ENCODER_TMDS = 2
MODE_PREFERRED, MODE_DRIVER = 1 << 3, 1 << 6
PHSYNC, NHSYNC, PVSYNC, NVSYNC = 1, 2, 4, 8
DPMS_ON = 0


class Modeinfo(ctypes.Structure):
    """A mode (struct drm_mode_modeinfo): pixel clock in kHz, then edges of line and picture in pixels and lines."""

    _fields_ = (
        ("clock", c_uint32),
        ("hdisplay", c_uint16),
        ("hsync_start", c_uint16),
        ("hsync_end", c_uint16),
        ("htotal", c_uint16),
        ("hskew", c_uint16),
        ("vdisplay", c_uint16),
        ("vsync_start", c_uint16),
        ("vsync_end", c_uint16),
        ("vtotal", c_uint16),
        ("vscan", c_uint16),
        ("vrefresh", c_uint32),
        ("flags", c_uint32),
        ("type", c_uint32),
        ("name", c_char * 32),
    )


class Version(ctypes.Structure):
    _fields_ = (
        ("major", c_int32),
        ("minor", c_int32),
        ("patch", c_int32),
        ("name_len", c_uint64),
        ("name", c_uint64),
        ("date_len", c_uint64),
        ("date", c_uint64),
        ("desc_len", c_uint64),
        ("desc", c_uint64),
    )


class Cap(ctypes.Structure):
    _fields_ = (("capability", c_uint64), ("value", c_uint64))


class Resources(ctypes.Structure):
    _fields_ = (
        ("fb_id_ptr", c_uint64),
        ("crtc_id_ptr", c_uint64),
        ("connector_id_ptr", c_uint64),
        ("encoder_id_ptr", c_uint64),
        ("count_fbs", c_uint32),
        ("count_crtcs", c_uint32),
        ("count_connectors", c_uint32),
        ("count_encoders", c_uint32),
        ("min_width", c_uint32),
        ("max_width", c_uint32),
        ("min_height", c_uint32),
        ("max_height", c_uint32),
    )


class ModeCrtc(ctypes.Structure):
    _fields_ = (
        ("set_connectors_ptr", c_uint64),
        ("count_connectors", c_uint32),
        ("crtc_id", c_uint32),
        ("fb_id", c_uint32),
        ("x", c_uint32),
        ("y", c_uint32),
        ("gamma_size", c_uint32),
        ("mode_valid", c_uint32),
        ("mode", Modeinfo),
    )


class CrtcLut(ctypes.Structure):
    _fields_ = (
        ("crtc_id", c_uint32),
        ("gamma_size", c_uint32),
        ("red", c_uint64),
        ("green", c_uint64),
        ("blue", c_uint64),
    )


class Encoder(ctypes.Structure):
    _fields_ = (
        ("encoder_id", c_uint32),
        ("encoder_type", c_uint32),
        ("crtc_id", c_uint32),
        ("possible_crtcs", c_uint32),
        ("possible_clones", c_uint32),
    )


class ModeGetConnector(ctypes.Structure):
    _fields_ = (
        ("encoders_ptr", c_uint64),
        ("modes_ptr", c_uint64),
        ("props_ptr", c_uint64),
        ("prop_values_ptr", c_uint64),
        ("count_modes", c_uint32),
        ("count_props", c_uint32),
        ("count_encoders", c_uint32),
        ("encoder_id", c_uint32),
        ("connector_id", c_uint32),
        ("connector_type", c_uint32),
        ("connector_type_id", c_uint32),
        ("connection", c_uint32),
        ("mm_width", c_uint32),
        ("mm_height", c_uint32),
        ("subpixel", c_uint32),
        ("pad", c_uint32),
    )


class PropertyEnum(ctypes.Structure):
    _fields_ = (("value", c_uint64), ("name", c_char * 32))


class Property(ctypes.Structure):
    _fields_ = (
        ("values_ptr", c_uint64),
        ("enum_blob_ptr", c_uint64),
        ("prop_id", c_uint32),
        ("flags", c_uint32),
        ("name", c_char * 32),
        ("count_values", c_uint32),
        ("count_enum_blobs", c_uint32),
    )


class ConnectorSetProperty(ctypes.Structure):
    _fields_ = (("value", c_uint64), ("prop_id", c_uint32), ("connector_id", c_uint32))


class ObjectProperties(ctypes.Structure):
    _fields_ = (
        ("props_ptr", c_uint64),
        ("prop_values_ptr", c_uint64),
        ("count_props", c_uint32),
        ("obj_id", c_uint32),
        ("obj_type", c_uint32),
    )


class ObjectSetProperty(ctypes.Structure):
    _fields_ = (("value", c_uint64), ("prop_id", c_uint32), ("obj_id", c_uint32), ("obj_type", c_uint32))


class Fb(ctypes.Structure):
    _fields_ = (
        ("fb_id", c_uint32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("pitch", c_uint32),
        ("bpp", c_uint32),
        ("depth", c_uint32),
        ("handle", c_uint32),
    )


class PageFlip(ctypes.Structure):
    _fields_ = (
        ("crtc_id", c_uint32),
        ("fb_id", c_uint32),
        ("flags", c_uint32),
        ("reserved", c_uint32),
        ("user_data", c_uint64),
    )


class DirtyFb(ctypes.Structure):
    _fields_ = (
        ("fb_id", c_uint32),
        ("flags", c_uint32),
        ("color", c_uint32),
        ("num_clips", c_uint32),
        ("clips_ptr", c_uint64),
    )


class CreateDumb(ctypes.Structure):
    _fields_ = (
        ("height", c_uint32),
        ("width", c_uint32),
        ("bpp", c_uint32),
        ("flags", c_uint32),
        ("handle", c_uint32),
        ("pitch", c_uint32),
        ("size", c_uint64),
    )


class MapDumb(ctypes.Structure):
    _fields_ = (("handle", c_uint32), ("pad", c_uint32), ("offset", c_uint64))


class U32(ctypes.Structure):
    _fields_ = (("value", c_uint32),)


FLIP_COMPLETE = struct.Struct("<IIQIIII")
"""Type, length, user data, seconds, microseconds, sequence, crtc."""


def mode(name: str, clock_khz: int, h: tuple[int, ...], v: tuple[int, ...], flags: int, preferred: bool) -> Modeinfo:
    """Return a mode line: (active, sync start, sync end, total) of both directions."""
    kind = MODE_DRIVER | (MODE_PREFERRED if preferred else 0)
    refresh_hz = round(clock_khz * 1000 / (h[3] * v[3]))
    return Modeinfo(clock_khz, *h, 0, *v, 0, refresh_hz, flags, kind, name.encode())


class OwnMemory:
    """User space in this process; its functions raise OSError(EFAULT) for a null address, as the kernel's."""

    def copy_to_user(self, address: int, data: bytes) -> None:
        """Write ``data`` to the address."""
        if data:
            if address == 0:
                raise OSError(14, "Bad address")
            ctypes.memmove(address, data, len(data))

    def copy_from_user(self, address: int, size: int) -> bytes:
        """Return ``size`` bytes from the address."""
        if size == 0:
            return b""
        if address == 0:
            raise OSError(14, "Bad address")
        return ctypes.string_at(address, size)
