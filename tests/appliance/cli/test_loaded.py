"""A verb loads what it needs and no more, and every verb that is listed is there with its arguments."""

from __future__ import annotations

import argparse
import importlib
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from appliance.cli import main
from appliance.cli.arguments import (
    Verb,
    collect,
    declare,
    number,
    number_above,
    operands,
    option,
    repeated,
    whole_number,
)
from appliance.cli.failures import FAILED, USAGE, exit_code_of
from appliance.cli.output import Exit
from appliance.cli.verbs import VERBS, Group, VerbEntry
from appliance.measure.calibration.file import CalibrationError
from appliance.store.config import default_rig_path
from appliance.store.library import Library, UnknownScan
from tests.appliance.store.scenes import ORIGIN, PREVIEW, cloud, frames, record

COMPUTES = ("numpy", "numba", "llvmlite", "scipy", "cv2")
DEVICES = ("usb", "serial", "moderngl", "hw_sim", "appliance.instrument.service", "appliance.desk")
EVERY = [
    ((*words, one.name), one)
    for group in VERBS
    for words, verbs in [((group.name,), group.verbs) if isinstance(group, Group) else ((), (group,))]
    for one in verbs
]


def loaded(*words: str | Path) -> set[str]:
    """The modules that a process has loaded when it has run the verb."""
    code = (
        "import sys; from appliance.cli import main\n"
        "try: code = main(sys.argv[1:])\n"
        "except SystemExit as end: code = end.code\n"
        "print('\\n' + ' '.join(sys.modules)); sys.exit(code)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, words)],
        capture_output=True, text=True, timeout=60, check=True, env=dict(os.environ),
    )  # fmt: skip
    return set(done.stdout.splitlines()[-1].split())


@pytest.mark.parametrize(("word", "more"), [("--help", ()), ("--version", ("base", "base.face", "base.distribution"))])
def test_help_and_the_version_load_nothing_else_of_the_product(word: str, more: tuple[str, ...]) -> None:
    mine = {name for name in loaded(word) if name.partition(".")[0] in ("appliance", "drivers")}
    needed = ("cli", "cli.main", "cli.arguments", "cli.output", "cli.verbs")
    assert mine == {"appliance", *(f"appliance.{name}" for name in (*needed, *more))}


def test_looking_at_scans_loads_nothing_that_computes_and_no_device(tmp_path: Path) -> None:
    library, rig = Library(tmp_path), tmp_path / "rig.toml"
    library.prepare()
    library.begin(frames(1), record(cloud={"points": 20}), ORIGIN).publish(record(), cloud(), PREVIEW)
    text = default_rig_path().read_text(encoding="utf-8").replace("/var/lib/kingfisher", str(tmp_path))
    rig.write_text(text, encoding="utf-8")
    for words in (("scans", "list", "--root", tmp_path), ("scans", "show", "1", "--root", tmp_path)):
        assert loaded(*words).isdisjoint((*COMPUTES, *DEVICES, "pydantic", "appliance.store.config"))
    found = loaded("scans", "list", "--rig", rig)
    assert (found.isdisjoint((*COMPUTES, *DEVICES)), "appliance.store.config" in found) == (True, True)


@pytest.mark.parametrize(("words", "listed"), EVERY, ids=lambda one: " ".join(one) if isinstance(one, tuple) else "")
def test_every_verb_says_what_may_be_typed_after_it(
    words: tuple[str, ...], listed: VerbEntry, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main([*words, "--help"])
    assert end.value.code == 0
    said = " ".join(capsys.readouterr().out.split())
    assert said.startswith(f"usage: kingfisher {' '.join(words)} [-h] [--json]")
    assert listed.text in said
    assert "exit codes: 0 ok, 1 failed, 2 usage" in said
    assert ("3 script failed" in said) == (words == ("sim",))
    assert ("4 damaged" in said) == (words in (("scans", "verify"), ("cloud",)))
    assert "docs/" not in said, "an installation does not have them"
    assert listed.load().run is not Verb.run


# ---------------------------------------------------------------------------------------- arguments


@dataclass(frozen=True, slots=True, kw_only=True)
class Dive(Verb):
    """A verb with each kind of argument that holds several values."""

    faults: tuple[str, ...] = repeated("--fault", "a fault", metavar="SENTENCE")
    scans: tuple[str, ...] = operands("SCAN", "numbers", at_least_one=False)
    reach_mm: float | None = option("--reach-mm", "so far", parse=number(0.5, 2.0, "mm"))


def typed(verb: type[Verb], *words: str) -> Verb:
    parser = argparse.ArgumentParser(exit_on_error=False)
    declare(verb, parser)
    return collect(verb, parser.parse_args(list(words)))


def test_an_option_that_is_repeated_keeps_all_values_and_none_of_the_call_before() -> None:
    assert typed(Dive, "--fault", "a", "7", "--fault", "b") == Dive(faults=("a", "b"), scans=("7",))
    assert typed(Dive, "--fault", "c", "--json") == Dive(faults=("c",), scans=(), json=True)
    assert typed(Dive, "--reach-mm", "0.5") == Dive(scans=(), reach_mm=0.5)


@pytest.mark.parametrize(
    ("parse", "good", "bad", "allowed"),
    [
        (whole_number(6, 200), {"6": 6, "200": 200, "0012": 12}, "5 201 -7 6.0 ٧ x 9999999999", "whole numbers 6..200"),
        (whole_number(0, 999_999_999), {"0": 0, "000": 0, "999999999": 999_999_999}, "1000000000 -1", "0..999999999"),
        (number(0.05, 16.0), {"0.05": 0.05, "16": 16.0, "1e1": 10.0}, "0.049 16.01 x nan inf", "allowed are 0.05..16"),
        (number(0.01, 50.0, "mm"), {"0.01": 0.01}, "0 50.1 nan", "allowed are numbers 0.01..50 (mm)"),
        (number_above(0.0, 10.0), {"10": 10.0, "0.001": 0.001}, "0 -1 10.01 nan", "numbers above 0, up to 10"),
    ],
)
def test_numbers_out_of_range_are_refused_with_the_range(
    parse: object, good: dict[str, object], bad: str, allowed: str
) -> None:
    assert callable(parse)
    assert {text: parse(text) for text in good} == good
    for text in bad.split():
        with pytest.raises(argparse.ArgumentTypeError) as error:
            parse(text)
        assert allowed in str(error.value)
        assert str(error.value).startswith((text, text.split(",")[-1]))


def test_what_a_person_can_do_something_about_ends_with_one_and_a_fault_of_the_program_is_raised() -> None:
    class ScriptFailed(Exception):
        exit_code = 3

    assert exit_code_of(UnknownScan("no scan 7")) is Exit.FAILED
    assert exit_code_of(CalibrationError("damaged")) is Exit.FAILED
    assert exit_code_of(ScriptFailed("line 3")) is Exit.SCRIPT_FAILED
    assert exit_code_of(ZeroDivisionError()) is None


@pytest.mark.parametrize("name", sorted(FAILED | USAGE))
def test_an_error_that_a_person_can_cure_is_told_in_a_line_wherever_its_class_lies(name: str) -> None:
    module, _, kind = name.partition(":")
    error = getattr(importlib.import_module(module), kind)
    assert error.__module__ == module, "named by another module, it would end as a fault of the program"
