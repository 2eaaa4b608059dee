"""The off-screen OpenGL context that draws patterns and screens without a window system."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import moderngl

from drivers.api import DeviceRefused


@contextlib.contextmanager
def open_gl() -> Iterator[moderngl.Context]:
    """Yield an OpenGL ≥ 3.3 core context on EGL, current in this thread, with output exact to the bit.

    Dithering (which GL switches on by default) and multisampling are off. Only the thread that opened it may use it.
    Raises DeviceRefused when EGL or a driver is missing.
    """
    settings: dict[str, Any] = {"backend": "egl"}
    try:
        context = moderngl.create_context(require=330, standalone=True, **settings)
    except Exception as error:  # the loader raises bare Exception for a missing library, a driver, or a version
        raise DeviceRefused(
            "gl",
            f"no OpenGL 3.3 context by EGL ({error})",
            "Install libegl1, libgl1 and libgl1-mesa-dri, or the driver of the graphics card",
        ) from error
    try:
        make_exact(context)
        yield context
    finally:
        context.release()


def make_exact(context: moderngl.Context) -> None:
    """Switch off all stages of the pipeline that change 8-bit codes."""
    dither, multisample, framebuffer_srgb = 0x0BD0, 0x809D, 0x8DB9
    for capability in (dither, multisample, framebuffer_srgb):
        context.disable_direct(capability)
