"""The walk through the steps: which comes next, what is kept of each, what the page shows, and what a new step costs."""

from __future__ import annotations

import datetime
import json
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from appliance.cli.main import main
from appliance.store.config import default_rig_path, parse_rig
from appliance.workshop import guide, projector, steps
from appliance.workshop.finding import BringupError, Finding
from appliance.workshop.guide import GuideOptions, GuideResult, is_current
from appliance.workshop.kept import NOTHING_YET, PAGE, STATE, STATE_FILE, GuideFolder, GuideState, StepRecord
from appliance.workshop.page import guide_page
from appliance.workshop.projector import measure_projector
from appliance.workshop.rig_edit import KeyValue
from appliance.workshop.step import GuideStep, StepOutcome, Workplace, inputs_of
from appliance.workshop.steps import STEPS
from drivers import rig as drivers_rig
from drivers.api import DeviceGone
from tests.appliance.instrument.service.test_start_and_end import nothing
from tests.appliance.workshop.scripted import RIG_FILE, AskedPerson
from tests.drivers.clock import SteppedClock
from tests.support.projector_model import Model, ModelBench, planes_in
from tests.support.told import Told

GOOD, BAD = Finding("rate", True, "60 Hz"), Finding("rate", False, "59 Hz", "60 Hz", "choose a mode of 60 Hz")
PNG = b"\x89PNG dark"
RIG = tomllib.loads(default_rig_path().read_text(encoding="utf-8"))
NAMES = tuple(step.name for step in STEPS)
BY_NAME = {step.name: step for step in STEPS}
OF_THE_PROJECTOR = tuple(step.name for step in STEPS if step.do == projector.measure_on_wall)


def scripted(*bad: str) -> tuple[GuideStep, ...]:
    """The steps with nothing to be done and judges that find them good but for those named ``bad``."""

    def made(step: GuideStep) -> GuideStep:
        outcome = StepOutcome((BAD if step.name in bad else GOOD,), {}, {f"{step.name}.png": ("It", PNG)})
        return replace(step, do=measured[step.do], judge=lambda _found, _rig: outcome)

    # One of its own for each measurement: those of the projector are done together.
    measured = {step.do: lambda _at: None for step in STEPS}
    return tuple(made(step) for step in STEPS)


class Bench:
    def __init__(self, folder: Path) -> None:
        self.rig_file = folder / "rig.toml"
        self.rig_file.write_text(RIG_FILE.read_text(encoding="utf-8"), encoding="utf-8")
        self.place = GuideFolder(folder / "out")
        self.place.prepare()

    def walk(self, listed: tuple[GuideStep, ...] | None = None, **options: Any) -> GuideResult:
        return guide._Walk(
            self.rig_file, self.place, GuideOptions(**options), wires(), AskedPerson(), Told(),
            lambda _name, _record: None, self.place.read(), scripted() if listed is None else listed,
        ).walk()  # fmt: skip


def wires() -> Any:
    today = SimpleNamespace(utc=datetime.datetime(2031, 5, 6, 7, 8, 9, 500, tzinfo=datetime.UTC), kept=True)
    return SimpleNamespace(clock=SteppedClock(), calendar=SimpleNamespace(today=lambda: today))


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_the_first_that_is_not_good_ends_it_and_the_next_call_goes_on_there(bench: Bench) -> None:
    walked = bench.walk(scripted("vsync"))
    assert (walked.good, walked.stopped, walked.done) == (False, None, ("board", "pad", "vsync"))
    walked = bench.walk(scripted("cameras"))
    assert walked.done == ("vsync", "cameras")
    assert list(walked.steps) == ["board", "pad", "vsync", "cameras"]
    assert not walked.steps["cameras"].good
    walked = bench.walk(scripted("light"))
    assert walked.done == ("cameras", "trigger", *OF_THE_PROJECTOR, "endurance"), "which needs no light"
    assert walked.stopped == "step plane needs light, which is not good; do that first"


def test_only_these_and_again_those(bench: Bench) -> None:
    bench.walk()
    assert bench.walk(only=("pad",)).done == ("pad",)
    walked = bench.walk(scripted("pad"), only=("pad",))
    assert (walked.done, walked.good) == (("pad",), False)
    walked = bench.walk(only=("board",))
    assert (walked.done, walked.good) == (("board",), True), "the pad was not asked for"
    assert not bench.walk(scripted("pad")).good
    assert bench.walk(only=("sides", "light")).done == OF_THE_PROJECTOR


@pytest.mark.parametrize("mirrored", [False, True])
def test_keys_are_written_all_or_none_and_steps_rest_on_the_file_as_it_is_then(bench: Bench, mirrored: bool) -> None:
    model = Model(planes_in(0.0, 16_000.0), latency=1, mirrored=mirrored)

    def do(at: Workplace) -> Any:
        return measure_projector(ModelBench(model, size_px=(32, 24), camera_px=(24, 18)), 12.0, at.say)

    listed = tuple(replace(step, needs=(), do=do) for step in STEPS if step.name in OF_THE_PROJECTOR)
    before, kept = bench.rig_file.read_text(encoding="utf-8"), bench.rig_file.with_name("rig.toml.before-1")
    walked = bench.walk(listed)
    text = bench.rig_file.read_text(encoding="utf-8")
    assert (walked.good, walked.done) == (not mirrored, OF_THE_PROJECTOR)
    if mirrored:
        assert (text, kept.exists()) == (before, False)
        assert not any(one.written for one in walked.steps.values())
        return
    assert parse_rig(text).projector.latency_blanks == 1
    assert kept.read_text(encoding="utf-8") == before
    light = walked.steps["light"]
    assert light.written["projector.latency_blanks"] == light.inputs["projector.latency_blanks"] == 1
    assert bench.walk(listed).done == (), "what it wrote undoes nothing"
    bench.walk(listed, only=("light",))
    assert not kept.with_name("rig.toml.before-2").exists(), "what is right already is not written again"


@pytest.mark.parametrize(
    ("error", "name", "said", "remedy"),
    [
        (DeviceGone("keys", "no key pad", "Check the cable"), "keys", "no key pad", "Check the cable"),
        (BringupError("it is dark; light it"), "measurement", "it is dark", "light it"),
        (BringupError("it is dark"), "measurement", "it is dark", "see the findings above"),
    ],
)
def test_what_ends_a_step_early_is_a_finding(error: Exception, name: str, said: str, remedy: str, bench: Bench) -> None:
    def fail(_at: Workplace) -> StepOutcome:
        raise error

    walked = bench.walk((replace(BY_NAME["pad"], do=fail),))
    (found,) = walked.steps["pad"].findings
    assert (found.name, found.ok, found.said, found.remedy) == (name, False, said, remedy)


def test_a_folder_that_is_new_has_an_empty_state_and_the_page_shows_its_own_pictures(tmp_path: Path) -> None:
    (tmp_path / "secret.png").write_bytes(PNG)
    place = GuideFolder(tmp_path / "a" / "b")
    place.prepare()
    assert place.read() == NOTHING_YET
    assert place.write({"dark.png": PNG}) == [place.folder / "dark.png"]
    others = {"gone.png": "Taken away", "../../secret.png": "?", str(tmp_path / "secret.png"): "?"}
    pictures = {file: (caption, PNG) for file, caption in ({"dark.png": "Dark"} | others).items()}
    record = StepRecord.of(StepOutcome((GOOD,), {}, pictures), "", 1.0, {})
    state = replace(NOTHING_YET, steps={"cameras": record})
    place.write({STATE: STATE_FILE.encode(state)})
    assert place.read() == state
    assert place.pictures(state) == {"dark.png": PNG}, "a picture's name leads nowhere else"


def changed(table: str, key: str, value: object) -> dict[str, object]:
    content = tomllib.loads(default_rig_path().read_text(encoding="utf-8"))
    inner = content
    for part in table.split("."):
        inner = inner[part]
    inner[key] = value
    return content


def kept(name: str, good: bool = True, content: dict[str, object] | None = None) -> GuideState:
    remedy = "" if good else "choose <another> mode"
    finding = Finding("rate", good, "60.001 Hz", "60 ± 0.1 Hz", remedy, {"rate_hz": 60.001})
    settings, keys = ({"feature": "Gamma", "is": 1.0},), {KeyValue("projector", "latency_blanks"): 1}
    outcome = StepOutcome((finding,), {"Settings": settings}, {"light.png": ("Light", b"\x89PNG light")}, keys)
    inputs = inputs_of(content or RIG, BY_NAME[name], STEPS)
    record = StepRecord.of(outcome, "2031-05-06T07:08:09+00:00", 12.5, inputs)
    return GuideState("/etc/rig.toml", "ab" * 32, {"Versions": ("kingfisher",)}, {name: record})


def still(name: str, now: dict[str, Any], good: bool = True, then: dict[str, object] | None = None) -> bool:
    step = BY_NAME[name]
    return is_current(kept(name, good, then), step, inputs_of(now, step, STEPS))


def test_no_step_needs_one_that_comes_later() -> None:
    assert all(set(step.needs) <= set(NAMES[:number]) for number, step in enumerate(STEPS))


def test_a_good_step_stands_until_a_key_that_it_rests_on_changes_comes_or_goes() -> None:
    assert still("pad", RIG)
    assert still("pad", changed("camera.left", "serial", "ANOTHER"))
    assert not still("pad", changed("keys", "product_id", 7))
    line = changed("camera.left", "trigger_source", "Line3")
    assert not still("cameras", line)
    assert not still("cameras", changed("camera.left", "features", {"Gamma": 0.5}))
    assert not still("cameras", RIG, then=line)
    assert not still("board", RIG, good=False)
    assert not StepOutcome(()).good, "a step that found nothing is not good"


def test_keys_that_the_guide_finds_itself_undo_only_what_rests_on_them() -> None:
    names = ("cameras", "trigger", "raster", "endurance", "light", "plane")
    for table, key, value in (("board", "trigger_delay_us", 4000), ("camera.left", "exposure_ms", 5.0)):
        now = changed(table, key, value)
        assert [name for name in names if not still(name, now)] == ["light", "plane"]


def test_what_was_kept_is_read_as_it_was() -> None:
    state = kept("vsync")
    again = STATE_FILE.decode(STATE_FILE.encode(state), STATE)
    assert again == state
    assert again.steps["vsync"].written == {"projector.latency_blanks": 1}


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"[]",
        b"{}",
        b"\xff",
        b'{"schema": 1}',
        b'{"schema": 9, "steps": {}}',
        STATE_FILE.encode(kept("vsync"))[:-40],
    ],
)
def test_a_damaged_state_is_refused_with_what_to_do(data: bytes, bench: Bench) -> None:
    bench.place.write({STATE: data})
    with pytest.raises(BringupError, match=r"bringup\.json.*move it away"):
        bench.place.read()


def test_the_page_has_numbers_limits_remedy_pictures_and_the_rig_file_and_no_markup_of_others() -> None:
    page = guide_page(kept("board", good=False), STEPS, "[rig]\nname = '<b>'\n", {"light.png": b"\x89PNG light"})
    rig_file, remedy = "name = &#x27;&lt;b&gt;&#x27;", "choose &lt;another&gt; mode"
    for text in ("60.001 Hz", "60 ± 0.1 Hz", remedy, rig_file, "data:image/png"):
        assert text in page, text
    assert "<another>" not in page


def test_the_page_begins_with_what_is_to_be_done_next() -> None:
    assert "Next: <b>board</b>" in guide_page(NOTHING_YET, STEPS, "", {})
    stopped = guide_page(kept("board", good=False), STEPS, "", {})
    assert stopped.index("Stopped at <b>board</b>") < stopped.index("<h2")
    done = replace(NOTHING_YET, steps=dict.fromkeys(NAMES, kept("board").steps["board"]))
    assert f"All {len(STEPS)} steps are good" in guide_page(done, STEPS, "", {})


def test_a_new_step_is_a_row_and_is_in_the_guide_on_the_page_and_in_the_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def do(at: Workplace) -> StepOutcome:
        at.person.tell("dip it into the pool")
        leak = Finding("leak", True, "no drop came in", "none", numbers={"drops": 0.0})
        return StepOutcome((leak,), pictures={"pool.png": ("The pool", PNG)})

    bench = Bench(tmp_path)
    monkeypatch.setattr(steps, "STEPS", (*STEPS, GuideStep("pool", "The pool", (), ("rig",), do)))
    monkeypatch.setattr(drivers_rig, "open_wires", lambda *_: nothing(SteppedClock()))
    given = ["setup", "guide", "--rig", str(bench.rig_file), "--out", str(tmp_path / "out"), "pool"]
    assert main([*given, "--json"]) == 0
    told = capsys.readouterr()
    assert "DO: dip it into the pool" in told.err
    (said,) = json.loads(told.out)["steps"]
    assert (said["name"], said["good"], said["findings"][0]["numbers"]) == ("pool", True, {"drops": 0.0})
    page = (tmp_path / "out" / PAGE).read_text(encoding="utf-8")
    assert "13. The pool (pool)" in page
    assert page.count("data:image/png") == 1
    assert main(given) == 0
    assert "1 of 13 steps are good" in capsys.readouterr().out
