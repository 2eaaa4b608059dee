"""Every test process finds the compiled kernels of this tree, also without ``./dev``, and begins as the instrument's do."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from appliance.base import kernel_cache
from appliance.base.process_start import use_one_blas_thread
from tests.support.golden_texts import Says

STAGES = {
    "tests/drivers": "devices",
    "tests/hw_sim": "devices",
    "tests/integration/drivers": "devices",
    "tests/integration": "dive",
    "tests/crash": "dive",
    "tests/metrology": "dive",
    "tests/scenarios": "dive",
    "tests/systemd": "foreign",
    "tests/libraries": "foreign",
    "tests/boot": "boot",
}
"""Stage of a folder's tests that state none (``./dev test --stage=NAME``)."""
STAGE_NAMES = frozenset(STAGES.values())

kernel_cache.use_kernel_cache()
use_one_blas_thread(os.environ)  # before anything imports NumPy


def stage_of_folder(path: Path, config: pytest.Config) -> str | None:
    """Return the stage of a file by its folder; ``None``: the default one, also where the folder or the file was named."""
    named = [Path(word.partition("::")[0]).absolute() for word in config.args]
    for name, stage in STAGES.items():
        folder = config.rootpath / name
        if path.is_relative_to(folder):
            return None if any(one.is_relative_to(folder) for one in named) else stage
    return None


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Import no file that has no test of the stage."""
    if collection_path.suffix != ".py" or not collection_path.name.startswith("test_"):
        return None
    expression = config.option.markexpr
    wanted = next((one for one in STAGE_NAMES if expression.startswith(one)), None)
    if wanted is None and not expression.startswith("not long"):  # other words than those of a stage
        return None
    if wanted is not None and f"mark.{wanted}" in collection_path.read_text(encoding="utf-8"):
        return None
    return True if stage_of_folder(collection_path, config) != wanted else None


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark the tests of each folder with its stage; those of a folder or file that was named run in whatever stage.

    Whole instruments come first: one that takes minutes leaves the other cores idle at the end.
    """
    items.sort(key=lambda item: not item.path.is_relative_to(config.rootpath / "tests/integration"))
    for item in items:
        stage = stage_of_folder(item.path, config)
        if stage is not None and not STAGE_NAMES & {mark.name for mark in item.iter_markers()}:
            item.add_marker(stage)


def pytest_configure(config: pytest.Config) -> None:
    """Tell how long tests took."""
    from tests.support.durations import Durations

    config.pluginmanager.register(Durations())


@pytest.fixture
def says(request: pytest.FixtureRequest) -> Says:
    """Compares sentences with ``tests/golden_texts.txt``: ``says(error)``."""
    return Says(request)
