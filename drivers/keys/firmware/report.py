"""The keypad's input report and its HID descriptor. Source: ``docs/protocols/keys.md``."""

REPORT_NUMBER, FIRMWARE, SEED = 0x01, 16, 0xA5
REPORT_BYTES = 8
DESCRIPTOR = (
    b"\x06\x4b\xff"  # usage page FF4B, of the vendor
    b"\x09\x01"  # usage 1
    b"\xa1\x01"  # collection: application
    b"\x85\x01"  # report number 1
    b"\x09\x02"  # usage 2
    b"\x15\x00"  # logical minimum 0
    b"\x26\xff\x00"  # logical maximum 255
    b"\x75\x08"  # fields of 8 bits
    b"\x95\x07"  # seven of them
    b"\x81\x02"  # input: data, variable, absolute
    b"\xc0"
)
"""One input report of seven bytes behind its number (HID 1.11, section 6.2.2)."""


def report(pressed: int, counter: int, faulty: int, time_ms: int) -> bytes:
    """Return the eight bytes of a report: two masks of keys, its counter, and the pad's clock in ms."""
    data = bytearray(REPORT_BYTES)
    data[0] = REPORT_NUMBER
    data[1] = pressed
    data[2] = counter & 0xFF
    data[3] = faulty
    data[4] = time_ms & 0xFF
    data[5] = time_ms >> 8 & 0xFF
    data[6] = FIRMWARE
    check = SEED
    for i in range(REPORT_BYTES - 1):
        check ^= data[i]
    data[7] = check
    return bytes(data)
