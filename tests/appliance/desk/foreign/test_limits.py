"""Where decoding ends: beyond the pattern, at disagreeing periods, at white."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from appliance.desk.foreign.camera import clean, decode_camera
from appliance.desk.foreign.decode import place_by_periods
from appliance.desk.foreign.description import AxisConvention, Description, ImageFiles
from appliance.desk.foreign.images import ImageSet, read_side
from appliance.desk.foreign.order import parse_order
from appliance.desk.foreign.problem import Table

SIZE_PX, PERIOD_PX, BITS = 1024, 32, 6


@pytest.mark.parametrize("count", [3, 5])
def test_phases_disagree_by_their_root_mean_square_however_many_there_are(count: int) -> None:
    """A limit in turns means the same for five periods as for three."""
    periods = tuple(1024.0 / n for n in (49, 48, 42, 40, 37)[:count])
    axis = AxisConvention("x", 1024, periods, ((0.0, 90.0, 180.0, 270.0),) * count)
    edge_px, off = np.full((1, 1), 600.0), 0.05
    fits = []
    for k, period in enumerate(periods):
        turns = np.asarray(edge_px / period + (off if k else 0.0), np.float32)
        fits.append(turns - np.floor(turns))
    coordinate_px, misfit = place_by_periods(fits, axis)
    assert float(misfit[0, 0]) == pytest.approx(off, abs=2e-3)
    assert float(coordinate_px[0, 0]) == pytest.approx(599.5, abs=0.1)


@pytest.mark.parametrize("brightest", [200, 255, 1023, 4095, 65535])
def test_the_least_full_scale_that_no_pixel_exceeds_is_white(tmp_path: Path, brightest: int) -> None:
    """Else saturated pixels pass for good ones, four times below white."""
    image = np.full((4, 4), brightest, np.uint8 if brightest < 256 else np.uint16)
    cv2.imwrite(str(tmp_path / "a.png"), image)
    shown = parse_order("bright", "order")
    files = {"left": ImageFiles(("a.png",))}
    description = Description("", tmp_path, files, shown, "grey", None, (SIZE_PX, 768), (), Table("", {}))
    assert read_side(description, "left").white == max(brightest, 255)


@pytest.mark.parametrize(("samples", "most_pixels"), [(1, 0.5), (32, 0.03)])
def test_stripes_of_three_pixels_say_their_own_error(samples: int, most_pixels: float) -> None:
    """Between its borders a coordinate is a straight line, which no neighbour contradicts: a third of the error was said.

    A pixel that is the mean over its area places borders to a hundredth of it; one that samples a point does not, and says so.
    """
    step_px, stripe_px, bits, height, width = 2.47, 8, 7, 24, 360
    u = np.arange(width)[:, None] + (np.arange(samples) + 0.5) / samples - 0.5
    start_px = np.linspace(20.0, 26.0, height)
    number = ((start_px[:, None, None] + step_px * u) / stripe_px).astype(int)
    stack, blur = [], np.exp(-0.5 * (np.arange(-2, 3) / 0.4) ** 2)
    for bit in reversed(range(bits)):
        lit = ((number ^ (number >> 1)) >> bit & 1).mean(axis=2)
        seen = np.stack([np.convolve(np.pad(row, 2, "edge"), blur / blur.sum(), "valid") for row in lit])
        stack += [np.rint(20.0 + 200.0 * one).astype(np.uint8) for one in (seen, 1.0 - seen)]
    shown = parse_order(f"(gray-x ~gray-x)*{bits}", "order")
    axis = AxisConvention("x", SIZE_PX, (), (), bits=bits, stripe_px=stripe_px)
    files = {"left": ImageFiles(("*",))}
    description = Description("", Path(), files, shown, "grey", None, (SIZE_PX, 768), (axis,), Table("", {}))
    found = clean(decode_camera(ImageSet(shown, (), np.stack(stack), 255.0), description).placed["x"])
    off_px = found.coordinate_px - (start_px[:, None] + step_px * np.arange(width) - 0.5)
    inner = np.isfinite(off_px) & (np.abs(np.arange(width) - width / 2) < 0.45 * width)
    error_px = float(np.sqrt(np.mean(off_px[inner] ** 2)))
    assert error_px < most_pixels * step_px
    assert error_px < 1.3 * float(np.sqrt(np.mean(found.sigma_px[inner] ** 2)))
    assert float(np.median(found.sigma_px[inner])) < max(2.0 * error_px, 0.01 * stripe_px)
