"""What is typed wrong is refused in one line that says what is right, before anything starts."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from pathlib import Path

import pytest

from appliance.cli import main
from appliance.cli.output import Exit, UsageError, log_lines
from appliance.cli.simrig import SimOptions, apply_options, check_simulated_wires, default_sim_rig
from appliance.cli.verbs import SECTIONS, VERBS
from appliance.store.config import default_rig_path, load_rig
from hw_sim.options import options_from
from hw_sim.truth import SETS

RIG = load_rig()


def code_of(argv: list[str]) -> int:
    try:
        return main(argv)
    except SystemExit as end:
        return int(end.code or 0)


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert (code_of(["--version"]), capsys.readouterr().out) == (0, "kingfisher 1.0.0rc1\n")


@pytest.mark.parametrize(
    ("argv", "words", "near"),
    [
        ("fly", "run", None), ("scans", "VERB is missing, give it: one of list, show,", None), ("scans list --al --root /nowhere", "--al", None),
        ("sim object=fish", "pipe", None), ("sim seed=-1", "seed=-1", None), ("sim seed=x --window pace=realtime", "0..999999999", None), ("cloud", "WHAT is missing, give it: scans, by", None),
        ("archive pull pi", "--out is missing; give", None), ("cloud /none", "SCAN", None), ("cloud 1 --mesh 2", "2: one word too many; give all operands", None), ("cloud 1 --out", "--out FILE: the value is missing", None),
        ("exprot", "VERB exprot: there is none; it is `kingfisher cloud`", None), ("clod", "VERB clod", "cloud"),
        ("scans merge", "it is `kingfisher cloud SCAN+SCAN`", None), ("calibrate air x", "VERB calibrate", "calibration"),
        ("sim --truth nominal", "--truth: is written truth=VALUE", None), ("sim --window truht=hard", "truht=hard: is no SETTING=VALUE", "truth"), ("scans lst", "VERB lst", "list"),
        ("scans list --rooot=/x", "--rooot: no such option", "--root"), ("compare 1 a.stl --tolerence 0.1", "0.1: one word too many", "--tolerance"),
        ("check 1", "1: one word too many", None), ("scans xyzzy", "there are: list, show", None),
    ],
)  # fmt: skip
def test_wrong_words_are_one_line_that_says_what_is_right(
    argv: str, words: str, near: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert code_of(argv.split()) == 2
    error = capsys.readouterr().err
    assert words in error
    assert (f"did you mean {near}?" in error) == (near is not None)
    assert "choose from" not in error
    assert "arguments are required" not in error
    assert (error.count("\n"), near is None or len(error) < 250) == (1, True)


def test_help_lists_every_verb_under_a_heading_and_every_exit_code(capsys: pytest.CaptureFixture[str]) -> None:
    assert code_of(["--help"]) == 0
    text = capsys.readouterr().out
    assert sorted(verb for verbs in SECTIONS.values() for verb in verbs) == sorted(one.name for one in VERBS)
    for heading, verbs in SECTIONS.items():
        below = text.partition(f"\n{heading}:\n")[2].partition("\n\n")[0]
        assert [line.split()[0] for line in below.splitlines()] == list(verbs)
    assert text.endswith(f"exit codes: {', '.join(f'{one} {one.name.lower()}' for one in Exit)}\n".replace("_", " "))
    assert code_of(["help"]) == 0
    assert capsys.readouterr().out == text
    assert code_of(["help", "scans", "list"]) == 0
    assert "SHELF" in capsys.readouterr().out


@pytest.mark.parametrize("verb", [["run"], ["check"], ["sim"], ["scans", "list"], ["calibration", "show"]])
def test_a_wrong_rig_file_is_named_with_its_key(
    verb: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "rig.toml"
    text = default_rig_path().read_text(encoding="utf-8")
    path.write_text(text.replace("exposure_ms = 12.0", "exposure_ms = 25", 1), encoding="utf-8")
    assert code_of([*verb, "--rig", str(path)]) == 2
    # The instrument's own verbs say where they found kernels, which is no mistake.
    (error,) = (line for line in capsys.readouterr().err.splitlines() if "kernels: " not in line)
    assert error.startswith("kingfisher: CONFIG: camera.left.exposure_ms 25 > 16.6; allowed: 0.05..16.6 ms")


def test_options_of_sim_become_options_of_the_world(tmp_path: Path) -> None:
    script = tmp_path / "dive.txt"
    script.write_text("end\n")
    given = {"texture": "none", "truth": "hard", "seed": 7, "pace": "realtime"}
    faults = ("camera.left off frame=9", "board off")
    rig = apply_options(RIG, SimOptions(root=tmp_path, object_name="plane", script=script, faults=faults, **given))  # type: ignore[arg-type]
    more = {"object": "plane", "script": str(script), "faults": [*faults], "status": str(tmp_path / "run/status.json")}
    assert rig.rig.wires_options == {**given, **more}
    assert rig.storage.root == tmp_path
    assert RIG.rig.wires_options == {}


def test_what_is_not_given_leaves_what_the_rig_file_says() -> None:
    wires = {"object": "shell", "faults": ["board off"], "seed": 5, "outside": {"seed": 4}}
    by_file = replace(RIG, rig=replace(RIG.rig, wires_options=wires))
    given = apply_options(by_file, SimOptions(faults=("keypad off",))).rig.wires_options
    assert given.items() >= {**wires, "faults": ["board off", "keypad off"]}.items()
    assert "seed" not in apply_options(RIG, SimOptions()).rig.wires_options
    # The harsher world is drawn by the seed of the command line or else of the rig file, or else by the world's own.
    assert apply_options(by_file, SimOptions(world="outside")).rig.wires_options["outside"] == {"seed": 5}
    assert "outside" not in apply_options(by_file, SimOptions(world="ordinary")).rig.wires_options
    assert apply_options(RIG, SimOptions(world="outside", seed=7)).rig.wires_options["outside"] == {"seed": 7}
    unsaid = apply_options(RIG, SimOptions(world="outside")).rig.wires_options
    assert options_from(unsaid).seed == unsaid["outside"]["seed"]


def test_smaller_cameras_keep_the_field_of_view_in_world_and_design() -> None:
    rig = apply_options(RIG, SimOptions(size="800x600"))
    assert (rig.camera.right.width_px, rig.camera.right.height_px) == (800, 600)
    assert (rig.rig.wires_options["width_px"], rig.rig.wires_options["height_px"]) == (800, 600)
    assert rig.design.pixel_um * 800 == pytest.approx(RIG.design.pixel_um * 1600)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        *((SimOptions(size=size), r"1600:1200; for example 800x600") for size in ("800x800", "800", "40x30", "x", "-800x-600", "800x600x3", "99999x74999")),
        (SimOptions(script=Path("/none")), "--script"), (SimOptions(truth="nowhere"), "nominal, realistic, hard, paper, modelled"),
    ],
    ids=str,
)  # fmt: skip
def test_a_size_of_another_shape_and_a_script_or_truth_that_is_not_there_are_refused(
    options: SimOptions, said: str
) -> None:
    with pytest.raises(UsageError, match=said):
        apply_options(RIG, options)


@pytest.mark.parametrize("truth", SETS)
def test_every_set_of_the_world_is_a_truth(truth: str) -> None:
    assert apply_options(RIG, SimOptions(truth=truth)).rig.wires_options["truth"] == truth


def test_windows_are_the_worlds_and_idle_time_is_then_a_persons() -> None:
    rig = apply_options(RIG, SimOptions(window=True))
    assert (rig.display, rig.projector) == (RIG.display, RIG.projector), "the instrument stays as it is"
    assert (rig.rig.wires_options["window"], rig.rig.wires_options["pace"]) == (True, "attended")
    assert "window" not in apply_options(RIG, SimOptions()).rig.wires_options
    assert apply_options(RIG, SimOptions(window=True, pace="lockstep")).rig.wires_options["pace"] == "lockstep"


def test_sim_starts_no_real_instrument() -> None:
    with pytest.raises(UsageError, match=r"drivers\.native:open.*kingfisher run"):
        check_simulated_wires(RIG)
    assert default_sim_rig().parts[-3:] == ("hw_sim", "rigs", "full.toml")
    rig = load_rig(default_sim_rig())
    assert check_simulated_wires(rig) is rig


@pytest.mark.parametrize("service", [True, False])
def test_a_service_tells_its_news_and_others_only_warn(service: bool, capsys: pytest.CaptureFixture[str]) -> None:
    log = logging.getLogger("kingfisher")
    with log_lines(as_json=False, service=service):
        log.info("display works")
        log.warning("uncalibrated: %s", "no file")
    log.warning("nobody listens")
    lines = capsys.readouterr().err.splitlines()
    wanted = ["kingfisher: display works", "kingfisher: uncalibrated: no file"]
    assert lines[:2] == wanted if service else lines[:1] == wanted[1:]
    with log_lines(as_json=True, service=service):
        log.warning("uncalibrated: %s", "no file")
    assert json.loads(capsys.readouterr().err.splitlines()[-1]) == {"warning": "uncalibrated: no file"}
