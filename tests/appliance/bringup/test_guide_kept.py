"""What is kept of a guided bring-up: which steps stand, which are done again and why, and what the page shows."""

from __future__ import annotations

import json
import tomllib

import pytest

from appliance.bringup.finding import BringupError, Finding
from appliance.bringup.guide import NAMES, OF_THE_PROJECTOR, STEPS, StepOutcome, inputs_of, step_of
from appliance.bringup.guide_page import guide_page
from appliance.bringup.guide_state import GuideState, StepRecord, read_state
from appliance.bringup.rig_edit import KeyValue
from appliance.config import default_rig_path

RIG = tomllib.loads(default_rig_path().read_text(encoding="utf-8"))


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
    settings, written = ({"feature": "Gamma", "is": 1.0},), {KeyValue("projector", "latency_blanks"): 1}
    outcome = StepOutcome((finding,), {"Settings": settings}, {"light.png": ("Light", b"\x89PNG light")}, written)
    record = StepRecord.of(outcome, "2031-05-06T07:08:09+00:00", 12.5, inputs_of(content or RIG, step_of(name)))
    return GuideState("/etc/rig.toml", "ab" * 32, {}, {"Versions": ("kingfisher",)}).with_step(name, record)


def test_no_step_needs_one_that_comes_later() -> None:
    for number, step in enumerate(STEPS):
        assert set(step.needs) <= set(NAMES[:number])
    assert set(OF_THE_PROJECTOR) < set(NAMES)


def test_a_good_step_stands_until_a_key_that_it_rests_on_changes() -> None:
    state, step = kept("pad"), step_of("pad")
    assert state.stands(step, RIG)
    assert state.stands(step, changed("camera.left", "serial", "ANOTHER"))
    now = changed("keys", "product_id", 7)
    assert not state.stands(step, now)
    assert state.outdated(step, now) == ["keys.product_id"]


def test_a_key_that_came_or_went_counts_as_changed() -> None:
    cameras, line = step_of("cameras"), changed("camera.left", "trigger_source", "Line3")
    for now in (line, changed("camera.left", "features", {"Gamma": 0.5})):
        assert not kept("cameras").stands(cameras, now)
    assert not kept("cameras", content=line).stands(cameras, RIG)


def test_keys_that_the_guide_finds_itself_undo_only_what_rests_on_them() -> None:
    steps = ("cameras", "trigger", "raster", "endurance", "light", "plane")
    for table, key, value in (("board", "trigger_delay_us", 4000), ("camera.left", "exposure_ms", 5.0)):
        now = changed(table, key, value)
        assert [name for name in steps if not kept(name).stands(step_of(name), now)] == ["light", "plane"]


def test_a_step_that_is_not_good_never_stands_and_nothing_found_is_not_good() -> None:
    assert not kept("board", good=False).stands(step_of("board"), RIG)
    assert not StepOutcome(()).good


def test_what_was_kept_is_read_as_it_was() -> None:
    state = kept("vsync")
    again = read_state(state.as_bytes(), "bringup.json")
    assert again.as_bytes() == state.as_bytes()
    assert again.steps["vsync"].written == {"projector.latency_blanks": 1}


@pytest.mark.parametrize(
    "data",
    [b"", b"[]", b"{}", b"\xff", b'{"schema": 1}', b'{"schema": 9, "steps": {}}', kept("vsync").as_bytes()[:-40]],
)
def test_a_damaged_state_is_refused_with_what_to_do(data: bytes) -> None:
    with pytest.raises(BringupError, match=r"bringup\.json.*move it away"):
        read_state(data, "bringup.json")


def test_the_page_has_numbers_limits_remedy_pictures_and_the_rig_file_and_no_markup_of_others() -> None:
    page = guide_page(kept("board", good=False), "[rig]\nname = '<b>'\n", {"light.png": b"\x89PNG light"})
    rig_file, remedy = "name = &#x27;&lt;b&gt;&#x27;", "choose &lt;another&gt; mode"
    for text in ("60.001 Hz", "60 ± 0.1 Hz", remedy, rig_file, "data:image/png"):
        assert text in page, text
    assert "<another>" not in page


def test_the_page_begins_with_what_is_to_be_done_next() -> None:
    assert "Next: <b>board</b>" in guide_page(GuideState(), "", {})
    stopped = guide_page(kept("board", good=False), "", {})
    assert stopped.index("Stopped at <b>board</b>") < stopped.index("<h2")
    done = json.loads(kept("board").as_bytes())
    done["steps"] = dict.fromkeys(NAMES, done["steps"]["board"])
    assert "All twelve steps are good" in guide_page(read_state(json.dumps(done).encode(), "x"), "", {})
