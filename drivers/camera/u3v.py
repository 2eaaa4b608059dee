"""The numbers of USB3 Vision and GenCP: every constant of the wire in one table.

Sources: USB3 Vision 1.0 (AIA), sections 3 (device class), 4 (control), 5 (streaming) and annex (registers); GenICam
GenCP 1.1 (EMVA), sections 3 (packets) and 4 (bootstrap registers). All values are little endian on the wire.
"""

from __future__ import annotations

from enum import IntEnum

# ------------------------------------------------------------------------- USB descriptors (U3V section 3)

USB_CLASS_MISCELLANEOUS = 0xEF
U3V_SUBCLASS = 0x05
PROTOCOL_CONTROL = 0x00
PROTOCOL_STREAM = 0x02

DEVICE_INFO_DESCRIPTOR_TYPE = 0x24
DEVICE_INFO_DESCRIPTOR_SUBTYPE = 0x01
DEVICE_INFO_LENGTH = 20

# ------------------------------------------------------------------------------- control (GenCP section 3)

CONTROL_MAGIC = 0x43563355
"""Prefix ``U3VC`` in the order of the bytes on the wire."""
CONTROL_HEADER_SIZE = 12
FLAG_ACKNOWLEDGE = 0x4000

COMMAND_READ = 0x0800
ANSWER_READ = 0x0801
COMMAND_WRITE = 0x0802
ANSWER_WRITE = 0x0803
ANSWER_PENDING = 0x0805

READ_COMMAND_SIZE = 12
"""Address u64, reserved u16, count u16."""
WRITE_ADDRESS_SIZE = 8
REQUEST_ID_FIRST = 1
REQUEST_ID_LAST = 0xFFFF


class Status(IntEnum):
    """Status codes of an acknowledge (GenCP table 9; U3V table 4-3) and of a stream trailer."""

    SUCCESS = 0x0000
    NOT_IMPLEMENTED = 0x8001
    INVALID_PARAMETER = 0x8002
    INVALID_ADDRESS = 0x8003
    WRITE_PROTECT = 0x8004
    BAD_ALIGNMENT = 0x8005
    ACCESS_DENIED = 0x8006
    BUSY = 0x8007
    MESSAGE_TIMEOUT = 0x800B
    INVALID_HEADER = 0x800E
    WRONG_CONFIGURATION = 0x800F
    GENERIC_ERROR = 0x8FFF
    RESEND_NOT_SUPPORTED = 0xA001
    STREAM_ENDPOINT_HALTED = 0xA002
    PAYLOAD_SIZE_NOT_ALIGNED = 0xA003
    STREAM_REGISTERS_INCONSISTENT = 0xA004
    DATA_DISCARDED = 0xA100
    DATA_OVERRUN = 0xA101


# -------------------------------------------------------------------- technology-agnostic bootstrap registers

ABRM_GENCP_VERSION = 0x000
ABRM_MANUFACTURER_NAME = 0x004
ABRM_MODEL_NAME = 0x044
ABRM_FAMILY_NAME = 0x084
ABRM_DEVICE_VERSION = 0x0C4
ABRM_MANUFACTURER_INFO = 0x104
ABRM_SERIAL_NUMBER = 0x144
ABRM_USER_NAME = 0x184
ABRM_DEVICE_CAPABILITY = 0x1C4
ABRM_MAX_RESPONSE_TIME_MS = 0x1CC
ABRM_MANIFEST_ADDRESS = 0x1D0
ABRM_SBRM_ADDRESS = 0x1D8
ABRM_TIMESTAMP = 0x1F0
ABRM_TIMESTAMP_LATCH = 0x1F8
ABRM_STRING_SIZE = 64
ABRM_HEAD_SIZE = 0x1E0
"""Bytes up to the end of the SBRM address, with which all other registers are found."""

# --------------------------------------------------------- technology-specific (U3V) bootstrap registers, SBRM

SBRM_U3V_VERSION = 0x00
SBRM_CAPABILITY = 0x04
SBRM_MAX_COMMAND_SIZE = 0x14
SBRM_MAX_ACKNOWLEDGE_SIZE = 0x18
SBRM_STREAM_COUNT = 0x1C
SBRM_SIRM_ADDRESS = 0x20
SBRM_CURRENT_SPEED = 0x40
SBRM_SIZE = 0x44

# --------------------------------------------------------------------- streaming interface registers, SIRM

SIRM_INFO = 0x00
SIRM_CONTROL = 0x04
SIRM_REQUIRED_PAYLOAD_SIZE = 0x08
SIRM_REQUIRED_LEADER_SIZE = 0x10
SIRM_REQUIRED_TRAILER_SIZE = 0x14
SIRM_MAX_LEADER_SIZE = 0x18
SIRM_PAYLOAD_TRANSFER_SIZE = 0x1C
SIRM_PAYLOAD_TRANSFER_COUNT = 0x20
SIRM_FINAL_TRANSFER1_SIZE = 0x24
SIRM_FINAL_TRANSFER2_SIZE = 0x28
SIRM_MAX_TRAILER_SIZE = 0x2C
SIRM_REQUIREMENTS_SIZE = 0x18
"""Info, control and the three required sizes, read in one go."""
SIRM_ENABLE = 1

# --------------------------------------------------------------------------------------------- manifest

MANIFEST_COUNT_SIZE = 8
MANIFEST_ENTRY_SIZE = 64
MANIFEST_FORMAT_RAW = 0
MANIFEST_FORMAT_ZIP = 1

# ---------------------------------------------------------------------------------------------- stream

LEADER_MAGIC = 0x4C563355
"""Prefix ``U3VL`` in the order of the bytes on the wire."""
TRAILER_MAGIC = 0x54563355
"""Prefix ``U3VT`` in the order of the bytes on the wire."""
LEADER_SIZE = 52
TRAILER_SIZE = 32
PAYLOAD_TYPE_IMAGE = 1

SUPERSPEED_PACKET = 1024
"""Largest bulk packet at SuperSpeed; a transfer's buffer is a multiple of it, or the transfer may overflow."""

PIECE = 1 << 20
"""Largest transfer that every known camera and host accepts: that of most programs."""

# ------------------------------------------------------------------------------------------------ speed

SPEED_MBPS_OF_SBRM = {0x01: 2, 0x02: 12, 0x04: 480, 0x08: 5000, 0x10: 10000}
"""SBRM "current speed" to Mbit/s (low speed is 1.5, rounded up)."""
SPEED_MBPS_OF_HOST = {1: 2, 2: 12, 3: 480, 4: 5000, 5: 10000, 6: 20000}
"""libusb's ``enum libusb_speed`` to Mbit/s."""
SUPERSPEED_MBPS = 5000
