"""Phase of N steps: one kernel for any number against one compiled for each, and our own for four steps of 90°."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from appliance.desk.foreign.description import equal_steps
from appliance.desk.foreign.phase import ROWS_AT_ONCE, fit_sine, step_weights
from appliance.measure.decode.phase import fit_steps, phase, turns_of
from appliance.measure.decode.scratch import COORDINATE, MODULATION_HALF_DN
from bench.result import Measurement
from bench.timing import cpu_ms, median_of

WIDTH_PX, HEIGHT_PX = 1600, 1200
COUNTS = (3, 4, 5, 8)
PAIRS = 9
WHITE = np.float32(255.0)
Kernel = Callable[..., None]


_SOURCE = """
def kernel(images, weights, columns, white, found, saturated):
    height, width = images.shape[1:]
    {read_weights}
    for y in range(height):
        {rows}
        turns, modulation, offset, misfit, full = found[0, y], found[1, y], found[2, y], found[3, y], saturated[y]
        for x in range(width):
            {values}
            mean, cosine, sine = {mean}, {cosine}, {sine}
            {off}
            turns[x] = turns_of(cosine, sine)
            modulation[x] = sqrt(cosine * cosine + sine * sine)
            offset[x] = mean
            misfit[x] = sqrt(({left}) * per_freedom)
            full[x] = {top} >= white
"""
"""Source of ``fit_steps`` for one number of steps, fully unrolled: each weight and each sum of a pixel is in a
register."""


def specialised(count: int) -> Kernel:
    """Return ``fit_steps`` for ``count`` steps alone, as one would write it by hand."""
    every = range(count)
    source = _SOURCE.format(
        read_weights="; ".join(
            f"a{k}, c{k}, s{k}, p{k}, q{k} = weights[0, {k}], weights[1, {k}], weights[2, {k}], columns[0, {k}], columns[1, {k}]"
            for k in every
        ),
        rows="; ".join(f"i{k} = images[{k}, y]" for k in every),
        values="; ".join(f"v{k} = i{k}[x]" for k in every),
        mean=" + ".join(f"a{k} * v{k}" for k in every),
        cosine=" + ".join(f"c{k} * v{k}" for k in every),
        sine=" + ".join(f"s{k} * v{k}" for k in every),
        off="; ".join(f"o{k} = v{k} - mean - p{k} * cosine + q{k} * sine" for k in every),
        left=" + ".join(f"o{k} * o{k}" for k in every),
        top="v0" if count == 1 else f"max({', '.join(f'v{k}' for k in every)})",
    )
    names: dict[str, Any] = {"turns_of": turns_of, "sqrt": np.sqrt, "per_freedom": np.float32(1.0 / max(count - 3, 1))}
    exec(source, names)
    compiled: Kernel = numba.njit(nogil=True, error_model="numpy", fastmath={"contract"})(names["kernel"])
    return compiled


def measure() -> Iterator[Measurement]:
    """Yield CPU times of both kernels for a whole image in blocks of rows, of the conversion, and of compiling."""
    random = np.random.default_rng(1)
    for count in COUNTS:
        images = random.integers(0, 256, (count, HEIGHT_PX, WIDTH_PX), np.uint8)
        steps_deg = equal_steps(count)
        weights = np.round(step_weights(steps_deg), 12).astype(np.float32)
        angles = np.deg2rad(np.asarray(steps_deg))
        columns = np.stack([np.cos(angles), np.sin(angles)]).astype(np.float32)
        blocks = [images[:, k : k + ROWS_AT_ONCE].astype(np.float32) for k in range(0, HEIGHT_PX, ROWS_AT_ONCE)]
        outputs = [np.empty((4, *block.shape[1:]), np.float32) for block in blocks]
        saturated = [np.empty(block.shape[1:], np.bool_) for block in blocks]
        kernel = specialised(count)

        def fit_image(fit: Kernel, blocks: list[Any] = blocks, weights: Any = weights, columns: Any = columns,
                  outputs: list[Any] = outputs, saturated: list[Any] = saturated) -> None:  # fmt: skip
            for block, out, full in zip(blocks, outputs, saturated, strict=True):
                fit(block, weights, columns, WHITE, out, full)

        compiling_ms = cpu_ms(partial(fit_image, kernel))
        fit_image(fit_steps)
        pairs = [(_of(fit_image, fit_steps), _of(fit_image, kernel)) for _ in range(PAIRS)]
        general, special = np.array(pairs).T
        all_of_it = [cpu_ms(partial(fit_sine, list(images), steps_deg, float(WHITE))) for _ in range(PAIRS)]
        yield median_of(f"{count} steps: one kernel for any number", general, "ms")
        yield median_of(f"{count} steps: a kernel of its own", special, "ms")
        yield median_of(f"{count} steps: general over special, paired", general / special, "")
        yield median_of(f"{count} steps: with conversion of the images", all_of_it, "ms")
        yield Measurement(f"{count} steps: compiling a kernel of its own", compiling_ms, "ms")
        if count == 4:
            yield from _ours(images, general, fit_image)


def _of(fit_image: Callable[[Kernel], None], kernel: Kernel) -> float:
    return cpu_ms(partial(fit_image, kernel))


def _ours(
    images: NDArray[np.uint8], general: NDArray[Any], fit_image: Callable[[Kernel], None]
) -> Iterator[Measurement]:
    """Yield the time of our own kernel, which reads 8 bits, writes phase and modulation, and no residual."""
    row = np.zeros(max(COORDINATE, MODULATION_HALF_DN) + 2 * WIDTH_PX + 64, np.float32)

    def ours() -> None:
        for y in range(HEIGHT_PX):
            phase(images[0, y], images[1, y], images[2, y], images[3, y], row)

    ours()
    pairs = [(_of(fit_image, fit_steps), cpu_ms(ours)) for _ in range(PAIRS)]
    any_number, ours_ms = np.array(pairs).T
    yield median_of("4 steps: our own kernel, 8 bits", ours_ms, "ms")
    yield median_of("4 steps: general over our own, paired", any_number / ours_ms, "")
