"""One camera of a foreign set after decoding: coordinates with noise, masked edges, and an image."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.decode import BORDER_ERROR, AxisCoordinates, AxisMeasurement, Reason, measure, place
from appliance.desk.foreign.description import Description
from appliance.desk.foreign.images import ImageSet
from appliance.desk.foreign.order import Shows
from appliance.desk.foreign.phase import ROWS_AT_ONCE, Floats
from appliance.measure import CoordinateMap

MAD_TO_SIGMA = 1.4826
JUMP_STEPS, BEND_STEPS, EDGE_SIGMAS = 6.0, 1.5, 8.0
"""A pixel sees two surfaces where its coordinate jumps by the first multiple of the median change, or bends by the
second; noise may add the third multiple of its standard deviation."""
RIPPLE_STRIPES = (1.0, 1.5, 2.0)
"""Distances in stripes over which interpolated coordinates are compared."""
MAX_OF_MEDIAN = 8.0
"""Differences are cut at this multiple of their median."""
MOST_SAMPLES = 4_000_000
"""Number of pixels above which every second line is skipped for a median."""
_EVERY = 3
_OF_DIFFERENCE = 1.0 / 70.0
"""Variance of a fourth difference a − 4b + 6c − 4d + e is 70 times that of a coordinate: its inverse.

Curvature does not count in it.
"""


@dataclass(frozen=True, slots=True, eq=False)
class DecodedCamera:
    """One camera's images, decoded. Mappings are keyed ``x`` and ``y``; maps are (h, w)."""

    images: ImageSet
    measured: Mapping[str, AxisMeasurement]
    placed: Mapping[str, AxisCoordinates]
    grey: NDArray[np.uint8]
    """Image in even light: the bright frame, else the mean of the sine frames, else the brightest value of each pixel."""


def decode_camera(images: ImageSet, description: Description) -> DecodedCamera:
    """Decode one camera's images. Raises ForeignError."""
    measured = {axis.name: measure(images, axis) for axis in description.axes}
    return DecodedCamera(images, measured, _place_axes(measured, description), _picture(images, measured))


def place_again(camera: DecodedCamera, description: Description) -> DecodedCamera:
    """Return the camera with coordinates by another convention that reads the same images.

    Phase steps are turned, not fitted again.
    """
    return replace(camera, placed=_place_axes(camera.measured, description))


def _place_axes(measured: Mapping[str, AxisMeasurement], description: Description) -> dict[str, AxisCoordinates]:
    return {axis.name: place(measured[axis.name], axis, description.extent_px(axis)) for axis in description.axes}


def _picture(images: ImageSet, measured: Mapping[str, AxisMeasurement]) -> NDArray[np.uint8]:
    bright = images.image(Shows.BRIGHT)
    means = [measurement.mean for measurement in measured.values() if measurement.mean is not None]
    image = bright if bright is not None else means[0] if means else np.maximum.reduce(list(images.images))
    return np.asarray(np.clip(np.rint(image * np.float32(255.0 / images.white)), 0.0, 255.0), np.uint8)


@dataclass(frozen=True, slots=True, eq=False)
class CleanCamera:
    """Coordinates of one camera as points are made of them. Maps are (h, w)."""

    images: ImageSet
    axes: Mapping[str, CoordinateMap]
    """Keyed ``x`` and ``y``."""
    grey: NDArray[np.uint8]
    modulation_dn: Floats
    """Least modulation of all directions, in 255ths of full scale."""
    reason: NDArray[np.uint8]
    """Values of ``Reason``: that of the first direction without a coordinate; a pixel that sees two surfaces is
    NEIGHBOURS."""
    decoded: float
    """Share of the illuminated pixels that have all coordinates, edges included; 0 without light."""


def clean_camera(camera: DecodedCamera) -> CleanCamera:
    """Return the coordinates from which points are made, once the convention is settled."""
    placed = camera.placed.values()
    axes = {name: clean(coordinates) for name, coordinates in camera.placed.items()}
    reason = np.zeros(camera.grey.shape, np.uint8)
    for coordinates in placed:
        np.copyto(reason, coordinates.reason, where=reason == Reason.FOUND)
    valid = reason == Reason.FOUND
    illuminated = np.logical_and.reduce([coordinates.reason != Reason.WEAK for coordinates in placed])
    decoded = float(valid.sum() / illuminated.sum()) if illuminated.any() else 0.0
    edge = np.logical_or.reduce([np.isnan(coordinate_map.coordinate_px) for coordinate_map in axes.values()])
    reason[valid & edge] = Reason.NEIGHBOURS
    modulation_dn = np.minimum.reduce([coordinates.modulation for coordinates in placed]) * np.float32(
        255.0 / camera.images.white
    )
    return CleanCamera(camera.images, axes, camera.grey, modulation_dn, reason, decoded)


def clean(placed: AxisCoordinates) -> CoordinateMap:
    """Mask the edges of one direction, and estimate its noise, which follows from light and modulation."""
    coordinate = placed.coordinate_px
    typical_px, step_px = _noise(coordinate), _usual_step(coordinate)
    jump_px, bend_px = JUMP_STEPS * step_px + EDGE_SIGMAS * typical_px, BEND_STEPS * step_px + EDGE_SIGMAS * typical_px
    edge = np.zeros(coordinate.shape, np.bool_)
    for along in (0, 1):
        values, all_marks = (coordinate, edge) if along else (coordinate.T, edge.T)
        for begin in range(0, len(values), ROWS_AT_ONCE):
            marks = all_marks[begin : begin + ROWS_AT_ONCE]
            step = np.diff(values[begin : begin + ROWS_AT_ONCE], axis=1)
            # Missing neighbours (NaN) do not count.
            with np.errstate(invalid="ignore"):
                far = np.abs(step) > jump_px
                marks[:, 1:] |= far
                marks[:, :-1] |= far
                marks[:, 1:-1] |= np.abs(np.diff(step, axis=1)) > bend_px
    unmasked = np.where(edge, np.float32(np.nan), coordinate)
    noise = np.float32(1.0) / np.maximum(placed.modulation, np.float32(1e-3))
    if placed.mean is not None:
        # Photon noise grows with the root of the light: bright places have more noise, but less than in proportion.
        noise *= np.sqrt(np.maximum(placed.mean, np.float32(1.0)))
    finite_noise = noise[np.isfinite(unmasked)]
    sigma_px = noise * np.float32(typical_px / np.median(finite_noise) if finite_noise.size else typical_px)
    if placed.stripe_px:
        border_px = max(BORDER_ERROR * placed.stripe_px, _ripple(unmasked, placed.stripe_px / step_px))
        sigma_px = np.hypot(sigma_px, np.float32(border_px))
    if placed.bend_px:
        sigma_px = np.hypot(sigma_px, np.float32(placed.bend_px))
    return CoordinateMap(unmasked, np.asarray(sigma_px, np.float32), step_px)


def _fourth_differences(values: Floats, lag: int) -> Floats:
    """Return the absolute fourth differences (n,) along the rows, of pixels ``lag`` apart."""
    for _ in range(4):
        values = values[:, lag:] - values[:, :-lag]
    return np.abs(values[np.isfinite(values)])


def _noise(coordinate: Floats) -> float:
    """Return the typical standard deviation of a coordinate, by its differences along the rows.

    It is 0 without any differences.
    """
    differences = _fourth_differences(coordinate[:: 1 + coordinate.size // MOST_SAMPLES], 1)
    return float(MAD_TO_SIGMA * np.median(differences) * _OF_DIFFERENCE**0.5) if differences.size else 0.0


def _ripple(coordinate: Floats, width: float) -> float:
    """Return the typical standard deviation of coordinates between stripe borders ``width`` px apart.

    A line from border to border has no fourth difference from pixel to pixel, however wrong the borders are; over whole
    stripes it has.
    """
    usual = 0.0
    for lag in sorted({max(1, round(stripes * width)) for stripes in RIPPLE_STRIPES}):
        for values in (coordinate[::_EVERY], coordinate.T[::_EVERY]):
            differences = _fourth_differences(values, lag)
            if differences.size:
                # Root mean square, since such errors are many or none; differences at edges of objects are cut.
                cut = np.minimum(differences, np.float32(MAX_OF_MEDIAN) * np.median(differences))
                usual = max(usual, float(np.sqrt(np.mean(np.square(cut, dtype=np.float64)) * _OF_DIFFERENCE)))
    return usual


def _usual_step(coordinate: Floats) -> float:
    every = 1 + coordinate.size // MOST_SAMPLES
    steps = [1e-3]
    for values in (coordinate[:, ::every].T, coordinate[::every]):
        step = np.abs(np.diff(values, axis=1))
        steps += [float(np.median(step[np.isfinite(step)]))] if np.isfinite(step).any() else []
    return max(steps)
