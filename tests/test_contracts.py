"""The layers of pyproject.toml hold, and each contract bites: a copy with forbidden imports fails every one."""

from __future__ import annotations

import importlib
import pkgutil
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("base", "measure", "store", "calibrate", "desk", "instrument", "workshop")
FORBIDDEN = {
    "independent-truth": ("hw_sim -> drivers.api", "hw_sim -> appliance.measure.light"),
    "unaware-product": ("appliance.instrument.capture -> hw_sim", "drivers.camera -> hw_sim"),
    "drivers-below": ("drivers.board -> appliance.instrument.capture",),
    "firmware-alone": ("drivers.board.firmware -> drivers.board.line",),
    "concrete-drivers": (
        "appliance.instrument.capture -> drivers.camera",
        "appliance.instrument.machine -> drivers.rig",
        "appliance.desk -> drivers.camera",
    ),
    "rooms": (
        "appliance.base -> appliance.measure",
        "appliance.measure -> appliance.store",
        "appliance.store -> appliance.calibrate",
        "appliance.calibrate -> appliance.desk",
        "appliance.desk -> appliance.instrument",
        "appliance.instrument -> appliance.desk",
        "appliance.instrument -> appliance.workshop",
        "appliance.workshop -> appliance.cli",
    ),
    "face-of-base": ("appliance.store -> appliance.base.face",),
    "face-of-measure": ("appliance.desk -> appliance.measure.light.water",),
    "face-of-store": ("appliance.desk.report -> appliance.store.atomic",),
    "face-of-calibrate": ("appliance.cli -> appliance.calibrate.health",),
    "face-of-desk": ("appliance.cli -> appliance.desk.objects",),
    "face-of-instrument": ("appliance.workshop -> appliance.instrument.capture",),
    "face-of-workshop": ("appliance.cli -> appliance.workshop.steps",),
    "face-of-cli": ("appliance -> appliance.cli.main",),
    "measuring-core": (
        "appliance.measure.light -> appliance.measure.points",
        "appliance.measure.decode -> appliance.measure.points",
        "appliance.measure.points -> appliance.measure.verdicts",
    ),
    "running-instrument": (
        "appliance.instrument.machine -> appliance.instrument.service",
        "appliance.instrument.capture -> appliance.instrument.worker",
    ),
    "pure-core": ("appliance.instrument.machine -> subprocess", "appliance.measure.light -> pathlib"),
    "one-thread": ("appliance.instrument.machine -> threading", "appliance.measure.light -> threading"),
    "rooms-of-the-world": ("hw_sim.optics -> hw_sim.water", "hw_sim.devices -> hw_sim.rendering"),
    "timeless-physics": ("hw_sim.water -> hw_sim.timing",),
}
"""Imports that each contract must refuse, written at the end of a package's ``__init__``."""


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


def test_every_contract_holds_and_each_bites(tree: Path) -> None:
    held = lint(tree)
    assert held.returncode == 0, held.stdout + held.stderr
    assert f"{len(FORBIDDEN)} kept, 0 broken" in held.stdout
    for contract, chains in FORBIDDEN.items():
        inits: dict[Path, str] = {}
        for chain in chains:
            importer, imported = chain.split(" -> ")
            init = tree.joinpath(*importer.split("."), "__init__.py")
            inits.setdefault(init, init.read_text())
            init.write_text(f"{init.read_text()}\nimport {imported}\n")
        bitten = lint(tree, "--contract", contract)
        for init, before in inits.items():
            init.write_text(before)
        assert bitten.returncode == 1, bitten.stdout + bitten.stderr
        assert all(chain in bitten.stdout for chain in chains), bitten.stdout


@pytest.mark.parametrize("room", ROOMS)
def test_a_face_hands_out_no_name_that_a_module_of_its_room_has(room: str) -> None:
    """Python gives the module in the place of the name, as soon as somebody has imported the module."""
    face = importlib.import_module(f"appliance.{room}")
    assert not {module.name for module in pkgutil.iter_modules(face.__path__)} & {*face.__all__}
    with pytest.raises(AttributeError, match="its face has"):
        getattr(face, "no_such_name")  # noqa: B009


@pytest.mark.parametrize("room", ROOMS)
def test_each_name_in_a_face_has_its_sentence(room: str) -> None:
    lines = (ROOT / "appliance" / room / "__init__.py").read_text(encoding="utf-8").splitlines()
    assert not [line for line in lines if line.startswith("        ") and line.rstrip().endswith(",")]
