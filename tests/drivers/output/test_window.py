"""The same pictures in a window: on a real X server without a screen."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator

import pytest

from drivers.output.window import fit

needs_x = pytest.mark.skipif(shutil.which("Xvfb") is None, reason="Xvfb is not installed")


@pytest.fixture(scope="module")
def display_name() -> Iterator[str]:
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "640x480x24", "-nolisten", "tcp"],
        pass_fds=[write],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    try:
        with os.fdopen(read) as pipe:
            number = pipe.readline().strip()  # comes when the server is ready, or empty when it died
        assert number, "Xvfb did not start"
        yield f":{number}"
    finally:
        server.terminate()
        server.wait(10)


def run(script: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """A process of its own: a window library that fails may take the process with it."""
    clean = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    return subprocess.run(
        [sys.executable, "-c", script], env=clean | environment, capture_output=True, text=True, timeout=60, check=False
    )


PREAMBLE = """
import threading, time
import numpy as np
from drivers.output.outputs import Outputs
from drivers.output.gl import open_gl
from drivers.output.spec import OutputKind, OutputSpec

class Clock:
    now_ns = staticmethod(time.monotonic_ns)
    sleep_s = staticmethod(time.sleep)

class Wires:
    clock = Clock()

projector_spec = OutputSpec(OutputKind.WINDOW, None, None, 64, 48, 60.0)
display_spec = OutputSpec(OutputKind.WINDOW, None, None, 80, 40, 60.0)

def on_screen(output):
    window = output._surface
    with window.current():
        width, height = window._context.screen.size
        shown = np.frombuffer(window._context.screen.read(), np.uint8).reshape(height, width, 3)
    return shown[::-1]
"""


@needs_x
def test_both_windows_show_what_they_were_given_while_a_painter_draws_off_screen(display_name: str) -> None:
    done = run(
        PREAMBLE
        + """
rng = np.random.default_rng(1)
picture = rng.integers(0, 256, (40, 80, 3), dtype=np.uint8)
frames = [rng.integers(0, 256, (48, 64), dtype=np.uint8) for _ in range(6)]
with open_gl() as gl, Outputs(projector_spec, display_spec, Wires()) as outputs:
    display, projector = outputs.open_display(), outputs.open_projector()
    projector.load(frames)
    for _ in range(3):
        display.present(picture, 1.0)
    projector.show(4)
    with gl:
        canvas = gl.simple_framebuffer((4, 4))
        canvas.clear(1.0, 0.0, 0.0, 1.0)
        assert canvas.read()[:3] == bytes([255, 0, 0])
    np.testing.assert_array_equal(on_screen(display), picture)
    lit = on_screen(projector)
    np.testing.assert_array_equal(lit[:, :, 1], frames[4])
    assert not lit[:, :, [0, 2]].any()

    flips = []
    player = threading.Thread(target=lambda: flips.extend(
        projector.play(range(6), 0, lambda flip: None, lambda: False)))
    player.start(); player.join(10)
    steps_ms = np.diff([flip.time_ns for flip in flips]) / 1e6
    print([flip.index for flip in flips], [flip.sequence for flip in flips], steps_ms.round(1))
    assert all(step > 8 for step in steps_ms), "frames rushed by"
    assert [flip.index for flip in flips] == list(range(len(flips))) and flips
    assert flips[0].sequence is None
""",
        {"DISPLAY": display_name},
    )
    assert done.returncode == 0, done.stderr


@needs_x
def test_a_monitor_that_is_named_is_filled_and_a_window_that_its_user_closed_is_gone(display_name: str) -> None:
    done = run(
        PREAMBLE
        + """
import glfw
from dataclasses import replace
from drivers.api import DeviceGone
glfw.init()
name = glfw.get_monitor_name(glfw.get_monitors()[0]).decode()
spec = replace(display_spec, connector=name, width_px=60, height_px=40)
with Outputs(projector_spec, spec, Wires()) as outputs:
    display = outputs.open_display()
    window = display._surface
    picture = np.random.default_rng(1).integers(0, 256, (40, 60, 3), dtype=np.uint8)
    for _ in range(3):
        display.present(picture, 1.0)
    shown = on_screen(display)
    assert shown.shape == (480, 640, 3)
    whole = np.zeros_like(shown)
    whole[40:440, 20:620] = picture.repeat(10, 0).repeat(10, 1)  # whole pixels, in the middle of black
    np.testing.assert_array_equal(shown, whole)
    assert not glfw.get_window_attrib(window._handle, glfw.RESIZABLE)
    assert glfw.get_window_attrib(window._handle, glfw.CONTEXT_CREATION_API) == glfw.EGL_CONTEXT_API
    glfw.set_window_should_close(window._handle, True)
    for use in (lambda: display.present(picture, 1.0), window.create_picture, window.check_connection):
        try:
            use()
        except DeviceGone as gone:
            assert gone.device == "display" and "closed" in gone.message
        else:
            raise SystemExit("used a closed window")
        window.close()
""",
        {"DISPLAY": display_name},
    )
    assert done.returncode == 0, done.stderr


def test_without_a_display_server_the_error_says_what_to_do() -> None:
    done = run(
        PREAMBLE
        + """
from drivers.api import DeviceRefused
try:
    Outputs(projector_spec, display_spec, Wires()).open_display()
except DeviceRefused as refused:
    print(refused)
""",
        {},
    )
    assert "display: no window" in done.stdout, done.stderr
    assert "kind to kms" in done.stdout


@pytest.mark.parametrize(
    ("picture", "window", "place"),
    [
        ((800, 480), (800, 480), (0, 0, 800, 480)),
        ((1024, 768), (1920, 1080), (448, 156, 1024, 768)),  # whole pixels: not 1.4 times as large
        ((800, 480), (1920, 1080), (160, 60, 1600, 960)),
        ((1024, 768), (512, 768), (0, 192, 512, 384)),
        ((1000, 2), (100, 100), (0, 49, 100, 1)),  # a line stays a line, not nothing
        ((2, 1000), (100, 100), (49, 0, 1, 100)),
    ],
)
def test_a_picture_is_shown_whole_centred_and_in_whole_pixels(
    picture: tuple[int, int], window: tuple[int, int], place: tuple[int, int, int, int]
) -> None:
    assert fit(picture, window) == place
