"""One GL context for all screen tests, and a painter on it."""

from __future__ import annotations

from collections.abc import Iterator

import moderngl
import pytest

from appliance.screens.painter import Painter
from drivers.output.gl import open_gl


@pytest.fixture(scope="session")
def context() -> Iterator[moderngl.Context]:
    with open_gl() as gl:
        yield gl


@pytest.fixture
def painter(context: moderngl.Context) -> Iterator[Painter]:
    with Painter(context, (800, 480)) as made:
        yield made
