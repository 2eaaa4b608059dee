"""What a trainer types is done at once and answered; what is not understood changes nothing."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from hw_sim.people import commands
from hw_sim.people.console import Console, reading
from hw_sim.world import World, WorldOptions
from tests.hw_sim.conftest import SMALL
from tests.hw_sim.people.test_script import until


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    with World(WorldOptions(**{**SMALL, "world": "console"})) as made:
        yield made


@pytest.fixture
def console(world: World, tmp_path: Path) -> Console:
    world.clear_faults()
    return Console(world, tmp_path / "run" / "status.json")


def test_it_breaks_and_repairs(world: World, console: Console) -> None:
    assert console.answer("fault keypad off") == "done"
    assert console.answer("fault camera.left stuck frame=7") == "done"
    assert console.answer("faults") == "keypad off; camera.left stuck frame=7"
    assert console.answer("clear") == "done"
    assert console.answer("faults") == "nothing is broken"


def test_it_changes_what_is_before_the_instrument(world: World, console: Console) -> None:
    assert console.answer("object shell 0 0 500 0 20 0") == "done"
    assert console.answer("texture checker  # for edges") == "done"
    assert console.answer("water attenuation_per_m=2") == "done"
    assert world.scene.object == "shell"
    assert world.scene.texture == "checker"
    assert world.scene.water.attenuation_per_m == 2.0
    assert console.answer("where").startswith("shell at 0 0 500 0 20 0, texture checker, Water(")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("jump", "no: 'jump' is not understood; type help"),
        ("fault camera.left explode", "no: fault 'camera.left explode'"),
        ("object teapot", "no: object 'teapot'; allowed are plane"),
        ("texture tartan", "no: texture 'tartan'; allowed are none"),
        ("water attenuation_per_m=50", "no: water: attenuation_per_m = 50.0; allowed are 0..20"),
        ("worker kill", "no: no process for points is running"),
        ("press left", "no: key 'left'"),
        ("help teapot", "no: help: 'teapot' is no verb"),
    ],
)
def test_what_cannot_be_done_is_said_and_changes_nothing(world: World, console: Console, line: str, said: str) -> None:
    before = world.scene
    assert console.answer(line).startswith(said)
    assert world.scene == before
    assert world.broken == ()


def test_help_names_every_verb_and_every_fault(console: Console) -> None:
    listed = console.answer("help")
    for verb in (*commands.HELP, "press", "see", "faults", "where", "help"):
        assert f"  {verb} " in listed
        assert console.answer(f"help {verb}").startswith("  ")
    assert "camera" in console.answer("help fault")
    assert "leak" in console.answer("help fault")


def test_lines_come_from_a_descriptor_and_answers_are_logged(
    world: World, console: Console, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    reader, writer = os.pipe()
    with caplog.at_level(logging.INFO), reading(world, tmp_path / "status.json", reader):
        os.write(writer, b"object pipe\nfaul")
        until(lambda: world.scene.object == "pipe")
        os.write(writer, b"t keypad off\n")
        until(lambda: world.broken == ("keypad off",))
        os.close(writer)
        until(lambda: caplog.messages.count("done") == 2)
    os.close(reader)
    assert caplog.messages == ["console: type help", "done", "done"]
