"""One GL context, one painter and one canvas for all screen tests: opening one costs more than a picture."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl
import pytest

from appliance.instrument.machine.words import Language
from appliance.instrument.screens.canvas import Canvas
from appliance.instrument.screens.painter import Painter
from drivers.output.gl import open_gl

SIZE_PX = (800, 480)


@pytest.fixture(scope="session")
def context() -> Iterator[moderngl.Context]:
    with open_gl() as gl:
        yield gl


@pytest.fixture(scope="session")
def one_painter(context: moderngl.Context) -> Iterator[Painter]:
    with Painter(context, SIZE_PX) as made:
        yield made


@pytest.fixture
def painter(one_painter: Painter) -> Painter:
    one_painter.language = Language.ENGLISH
    return one_painter


@pytest.fixture
def canvas(context: moderngl.Context) -> Iterator[Canvas]:
    with context:
        made = Canvas(context, SIZE_PX)
        yield made
        made.close()
