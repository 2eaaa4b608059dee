"""A diver changes the fringe period, scans, looks at the scan in the gallery; and the screen never keeps anyone waiting."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from appliance.cli.simrig import SimOptions, default_sim_rig, simulated
from appliance.config import load_rig
from appliance.instrument import standard_choices
from appliance.screens.painter import Painter
from appliance.screens.views import AnyView, GalleryView, MenuView
from appliance.service.app import run
from appliance.service.keys import KeyReader
from appliance.storage.choices import ChoicesFile
from appliance.storage.library import Library
from appliance.worker import order, process
from drivers.api import KeyEvent, KeyPress

MOST_PICTURES = 2
"""From a press to its answer: at 60 Hz a third of the 100 ms that a diver may wait."""
DIVE = """
wait state AIM 90
press back            # UNCALIBRATED: seen
pause 0.5
press up
wait state MENU 5
press down
press scan
press up                    # 32 px
press scan
press back
wait state AIM 5
press scan
wait state REVIEW 90
press scan
wait state AIM 60
pause 3
press down
wait state GALLERY 5
pause 0.5
press back
wait state AIM 5
end
"""


@pytest.mark.long
def test_a_period_is_chosen_scanned_with_and_remembered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[KeyPress | AnyView] = []
    draw, take = Painter.draw, KeyReader.take

    def drawn(painter: Painter, view: AnyView, time_s: float) -> NDArray[np.uint8]:
        told.append(view)
        return draw(painter, view, time_s)

    def taken(reader: KeyReader) -> list[KeyEvent]:
        events = take(reader)
        told.extend(event for event in events if isinstance(event, KeyPress))
        return events

    # The machine that runs tests may be busy with others.
    monkeypatch.setattr(process, "WorkLimits", partial(order.WorkLimits, cloud_s=55.0))
    monkeypatch.setattr(Painter, "draw", drawn)
    monkeypatch.setattr(KeyReader, "take", taken)
    script = tmp_path / "dive.script"
    script.write_text(DIVE)
    options = SimOptions(
        root=tmp_path / "dive", object_name="plane", truth="nominal", seed=3, size="400x300", script=script
    )
    rig = simulated(load_rig(default_sim_rig()), options)
    assert run(rig) == 0

    library = Library(rig.storage.root)
    (scan_id,) = library.ids()
    stored = library.load(scan_id)
    assert stored.manifest.record.sequence.period_px == 32
    assert stored.frames["left"].shape == (22, 300, 400)
    assert stored.manifest.record.cloud["points"], "the worker knows the patterns"
    assert ChoicesFile(rig.storage.root, standard_choices(rig)).read()[0].period_px == 32

    presses = [k for k, what in enumerate(told) if isinstance(what, KeyPress)]
    assert len(presses) >= 11
    for press in presses[:-1]:  # the last one switches off
        before = next(what for what in reversed(told[:press]) if not isinstance(what, KeyPress))
        after = [what for what in told[press + 1 : press + 12] if not isinstance(what, KeyPress)]
        pictures = next((k for k, view in enumerate(after, 1) if _answers(before, view)), len(after) + 1)
        assert pictures <= MOST_PICTURES, f"{told[press]} over {type(before).__name__}: answered by picture {pictures}"
    shown = [view for view in told if isinstance(view, GalleryView) and view.points]
    assert shown, "the gallery has loaded the scan"
    assert (shown[-1].scan_id, shown[-1].damaged, shown[-1].count) == (scan_id, False, 1)
    assert shown[-1].preview is not None


def _answers(before: Any, after: Any) -> bool:
    if type(before) is not type(after):
        return True
    if isinstance(before, MenuView):
        return (before.rows, before.selected, before.keys) != (after.rows, after.selected, after.keys)
    return False
