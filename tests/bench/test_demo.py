"""What a newcomer reads of the demonstration: ten lines that can be understood, and never ten seconds of silence."""

from __future__ import annotations

import io
import logging
import time
from pathlib import Path
from typing import Any

from bench.demo import Pulse, in_words

SUMMARY: dict[str, Any] = {
    "scan": "000001",
    "frames": 24,
    "period_px": 16,
    "points": 825312,
    "completeness_percent": 99.6412,
    "rms_mm": 0.02137,
    "p99_mm": 0.06311,
    "mean_mm": 0.0001,
    "outliers_ppm": 2.42,
    "verdicts": {"motion": True, "light": None},
    "frame_verdicts": {"left": ["complete"] * 24, "right": ["complete"] * 23 + ["missing"]},
    "wall_s": {"compiling": 41.2, "dive": 30.6, "comparing": 8.7},
}


def test_the_end_says_in_ten_lines_what_was_measured_and_where_it_is() -> None:
    lines = in_words(SUMMARY, "pipe", Path("demo"))
    text = "\n".join(lines)
    assert len(lines) == 10
    assert max(map(len, lines)) <= 120
    for words in ("825,312", "99.6 %", "0.021 mm", "0.063 mm", "2 points off", "1 of them bad", "verdict       good"):
        assert words in text
    for name in ("display.png", "contact_sheet.png", "cloud.ply", "summary.json"):
        assert f"demo/{name}" in text
    assert "compiling 41 s, dive 31 s, comparing 9 s" in text


def test_a_scan_that_was_judged_bad_is_not_called_good() -> None:
    text = "\n".join(in_words(SUMMARY | {"verdicts": {"motion": False, "light": True}}, "pipe", Path("demo")))
    assert "bad: motion" in text
    assert "good" not in text


def test_while_nothing_happens_it_says_that_it_goes_on() -> None:
    heard = io.StringIO()
    with Pulse(heard, quiet_s=0.5) as pulse:
        log = logging.getLogger("demo")
        log.addHandler(pulse)
        log.setLevel(logging.INFO)
        try:
            pulse.begin("comparing")
            until_s = time.monotonic() + 20.0
            while heard.getvalue().count("comparing: ") < 2 and time.monotonic() < until_s:
                time.sleep(0.05)
        finally:
            log.removeHandler(pulse)
    assert heard.getvalue().count("comparing: ") >= 2
