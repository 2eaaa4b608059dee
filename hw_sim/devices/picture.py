"""Image processing in the camera: border, mirror, binning, region, grey values, packing.

The order is that of real cameras: geometry first, then grey values, then the format on the wire.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hw_sim.devices.makers import PIXEL_FORMATS
from hw_sim.devices.u3v_stream import Region

RENDERED_BLACK_DN = 2.0
"""Grey value without light in the world's images, which BlackLevel replaces."""
LUT_EXPONENT = 0.5
"""Exponent of the table behind LUTEnable, which brightens dark values for the eye."""
_DEPTH_BITS = {"Mono8": 8, "Mono10": 10, "Mono10p": 10, "Mono12": 12, "Mono12p": 12, "Mono16": 16}
_DEPTH_BITS_OF = {number: _DEPTH_BITS[name] for name, number in PIXEL_FORMATS.items()}
_PACKED = {PIXEL_FORMATS["Mono10p"], PIXEL_FORMATS["Mono12p"]}


@dataclass(frozen=True, slots=True)
class Processing:
    """The processing of each image, as the features state it."""

    reverse_x: bool = False
    reverse_y: bool = False
    binning: tuple[int, int] = (1, 1)
    """Numbers of columns and rows that are averaged to one."""
    decimation: tuple[int, int] = (1, 1)
    black_dn: float = RENDERED_BLACK_DN
    gamma: float = 1.0
    lut: bool = False
    pattern: str = "Off"


def bordered(image: NDArray[np.uint8], sensor: tuple[int, int]) -> NDArray[np.uint8]:
    """Return (h, w) of a sensor of (columns, rows) with the image in its middle and darkness around it."""
    rows, columns = image.shape
    left, top = (sensor[0] - columns) // 2, (sensor[1] - rows) // 2
    right, below = sensor[0] - columns - left, sensor[1] - rows - top
    return np.pad(image, ((top, below), (left, right)), constant_values=round(RENDERED_BLACK_DN))


def payload(image: NDArray[np.uint8], sensor: tuple[int, int], processing: Processing, region: Region) -> bytes:
    """Return the bytes of an image on the wire; ``image`` is (h, w) uint8, at most as large as the sensor."""
    r = region
    if processing.pattern != "Off":
        codes = _drawn(processing.pattern, r, _DEPTH_BITS_OF[r.pixel_format])
    else:
        placed = _placed(bordered(image, sensor), processing)
        cut = placed[r.offset_y : r.offset_y + r.height, r.offset_x : r.offset_x + r.width]
        table = grey_codes(processing, _DEPTH_BITS_OF[r.pixel_format])
        codes = np.take(table, cut)
    return packed(codes, r.pixel_format)


def _placed(pixels: NDArray[np.uint8], p: Processing) -> NDArray[np.uint8]:
    """Mirror, bin and decimate the pixels of the sensor."""
    pixels = pixels[:: -1 if p.reverse_y else 1, :: -1 if p.reverse_x else 1]
    (columns, rows), (every_x, every_y) = p.binning, p.decimation
    if (columns, rows) != (1, 1):
        height, width = pixels.shape[0] // rows, pixels.shape[1] // columns
        blocks = pixels[: height * rows, : width * columns].reshape(height, rows, width, columns)
        pixels = (blocks.mean(axis=(1, 3), dtype=np.float32) + np.float32(0.5)).astype(np.uint8)
    return pixels[::every_y, ::every_x]


def grey_codes(processing: Processing, depth_bits: int) -> NDArray[np.uint16]:
    """Return (256,) uint16: the code of ``depth_bits`` bits for each grey value of the image.

    Gamma is Y' = Y to the power of gamma with Y from 0 to 1 (SFNC 2.7, Gamma).
    """
    light = (np.arange(256) - RENDERED_BLACK_DN + processing.black_dn) / 255.0
    exponent = processing.gamma * (LUT_EXPONENT if processing.lut else 1.0)
    highest = (1 << depth_bits) - 1
    # Codes of more bits are those of 8 bits times a power of two, so that 255 is below the highest code.
    scale = 255.0 * (1 << depth_bits - 8)
    codes: NDArray[np.uint16] = np.round(np.clip(light, 0.0, 1.0) ** exponent * scale).astype(np.uint16)
    # A saturated pixel has the highest code, regardless of the black level.
    codes[255] = highest
    return codes


def _drawn(pattern: str, r: Region, depth_bits: int) -> NDArray[np.uint16]:
    ramp = np.add.outer(np.zeros(r.height, np.int64), np.arange(r.width))
    if pattern == "GreyVerticalRamp":
        ramp = np.add.outer(np.arange(r.height), np.zeros(r.width, np.int64))
    codes: NDArray[np.uint16] = (ramp % 256 << depth_bits - 8).astype(np.uint16)
    return codes


def packed(codes: NDArray[np.uint16], pixel_format: int) -> bytes:
    """Return codes (h, w) as the bytes of a pixel format.

    The formats with a "p" fill bits without gaps, the first pixel in the lowest bits of the first byte (PFNC 2.0, figure of
    Mono10p).
    """
    if pixel_format == PIXEL_FORMATS["Mono8"]:
        return codes.astype(np.uint8).tobytes()
    if pixel_format not in _PACKED:
        return codes.astype("<u2").tobytes()
    depth_bits = _DEPTH_BITS_OF[pixel_format]
    bits = np.unpackbits(codes.astype("<u2").reshape(-1, 1).view(np.uint8), axis=1, bitorder="little")
    return np.packbits(bits[:, :depth_bits].reshape(-1), bitorder="little").tobytes()
