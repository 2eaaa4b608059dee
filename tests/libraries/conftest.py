"""Worlds on device nodes, for programs that know nothing of them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import pytest

from hw_sim.wires.umockdev.testbed import Testbed
from hw_sim.world import World, WorldOptions


@pytest.fixture(autouse=True)
def _umockdev() -> None:
    if shutil.which("umockdev-wrapper") is None:
        pytest.skip("the package umockdev is not installed; ./dev test --stage=foreign installs it")


@pytest.fixture
def world(request: pytest.FixtureRequest) -> Iterator[World]:
    """Small cameras (or of the size that a test asks for), real time."""
    width, height = getattr(request, "param", (400, 300))
    with World(
        WorldOptions(world="bed", width_px=width, height_px=height, pace="realtime", stills=True, truth="modelled")
    ) as made:
        yield made


@pytest.fixture
def bed(world: World) -> Iterator[Testbed]:
    with Testbed(world) as made:
        yield made
