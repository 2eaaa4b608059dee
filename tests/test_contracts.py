"""The layers of pyproject.toml hold, and each contract bites: a copy with one forbidden import must fail it."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
CONTRACTS = [
    contract["id"]
    for contract in tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
]


@dataclass(frozen=True)
class Forbidden:
    """One import that ``contract`` must refuse, written at the end of a package's ``__init__``."""

    contract: str
    importer: str
    imported: str

    def __str__(self) -> str:
        return f"{self.contract}: {self.importer} imports {self.imported}"


FORBIDDEN = [
    Forbidden("independent-truth", "hw_sim", "drivers.api"),
    Forbidden("independent-truth", "hw_sim", "appliance.optics"),
    Forbidden("unaware-product", "appliance.capture", "hw_sim"),
    Forbidden("unaware-product", "drivers.camera", "hw_sim"),
    Forbidden("drivers-below", "drivers.board", "appliance.capture"),
    Forbidden("firmware-alone", "drivers.board.firmware", "drivers.board.line"),
    Forbidden("concrete-drivers", "appliance.capture", "drivers.camera"),
    Forbidden("concrete-drivers", "appliance.machine", "drivers.rig"),
    Forbidden("data-flow", "appliance.patterns", "appliance.capture"),
    Forbidden("data-flow", "appliance.reconstruct", "appliance.machine"),
    Forbidden("data-flow", "appliance.surface", "appliance.storage"),
    Forbidden("data-flow", "appliance.registration", "appliance.storage"),
    Forbidden("data-flow", "appliance.machine", "appliance.service"),
    Forbidden("data-flow", "appliance.offline", "appliance.service"),
    Forbidden("pure-core", "appliance.machine", "threading"),
    Forbidden("pure-core", "appliance.optics", "pathlib"),
    Forbidden("rooms-of-the-world", "hw_sim.optics", "hw_sim.water"),
    Forbidden("rooms-of-the-world", "hw_sim.devices", "hw_sim.rendering"),
    Forbidden("timeless-physics", "hw_sim.water", "hw_sim.timing"),
]


def lint(tree: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Check the contracts of the tree, which comes before the installed project on the path."""
    return subprocess.run(
        [sys.executable, "-c", "import importlinter.cli as c; c.lint_imports_command()", *arguments, "--no-logo"],
        cwd=tree,
        env={"PYTHONPATH": str(tree), "PATH": "", "COLUMNS": "200"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    copy = tmp_path_factory.mktemp("contracts") / "tree"
    copy.mkdir()
    shutil.copy(ROOT / "pyproject.toml", copy)
    for package in ("appliance", "drivers", "hw_sim"):
        shutil.copytree(ROOT / package, copy / package, ignore=shutil.ignore_patterns("__pycache__"))
    return copy


@pytest.fixture
def broken(tree: Path, request: pytest.FixtureRequest) -> Iterator[Forbidden]:
    forbidden: Forbidden = request.param
    init = tree.joinpath(*forbidden.importer.split("."), "__init__.py")
    before = init.read_text()
    init.write_text(f"{before}\nimport {forbidden.imported}\n")
    yield forbidden
    init.write_text(before)


def test_every_contract_holds(tree: Path) -> None:
    result = lint(tree)
    assert result.returncode == 0, result.stdout + result.stderr
    assert f"{len(CONTRACTS)} kept, 0 broken" in result.stdout


@pytest.mark.parametrize("broken", FORBIDDEN, ids=str, indirect=True)
def test_the_contract_bites(tree: Path, broken: Forbidden) -> None:
    result = lint(tree, "--contract", broken.contract)
    assert result.returncode == 1, result.stdout + result.stderr
    chain = rf"{re.escape(broken.importer)} -> {re.escape(broken.imported)}"
    assert re.search(chain, result.stdout), result.stdout


def test_every_contract_is_shown_to_bite() -> None:
    assert {forbidden.contract for forbidden in FORBIDDEN} == set(CONTRACTS)
