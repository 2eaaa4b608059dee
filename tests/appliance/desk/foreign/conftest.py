"""Foreign sets of the simulator, each rendered once for all tests of importing."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.support.commands import Shell
from tests.support.foreign_sets import ForeignSet, convention, make_set

WIDTH_PX = 240


@pytest.fixture(scope="session")
def foreign_set(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], ForeignSet]:
    """The set of a convention, by its name."""
    made: dict[str, ForeignSet] = {}

    def make(name: str) -> ForeignSet:
        if name not in made:
            made[name] = make_set(convention(name), tmp_path_factory.mktemp(name), WIDTH_PX)
        return made[name]

    return make


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str]) -> Shell:
    return Shell(capsys)
