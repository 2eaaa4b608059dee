"""A process of the instrument takes one thread for linear algebra, and its collector leaves alone what imports made."""

from __future__ import annotations

import json
import os
import subprocess
import sys

from appliance.process_start import BLAS_THREADS, use_one_blas_thread

IMPORTS = """
import gc, json
from appliance.process_start import importing
passes = []
gc.callbacks.append(lambda phase, _: passes.append(phase))
with importing():
    made = [[] for _ in range(100_000)]
inside = len(passes)
made += [[] for _ in range(10_000)]
print(json.dumps({"inside": inside, "after": len(passes), "looked at": len(gc.get_objects()), "on": gc.isenabled()}))
"""


def printed(program: str) -> str:
    without = {name: value for name, value in os.environ.items() if name != BLAS_THREADS}
    done = subprocess.run(
        [sys.executable, "-c", program], env=without, capture_output=True, text=True, timeout=100, check=True
    )
    return done.stdout


def test_the_collector_sleeps_while_modules_are_imported_and_never_looks_at_what_they_made() -> None:
    seen = json.loads(printed(IMPORTS))
    assert seen["inside"] == 0
    assert seen["on"]
    assert seen["after"] > 0
    assert 10_000 <= seen["looked at"] < 20_000, "of 110,000"


def test_linear_algebra_takes_one_thread_unless_somebody_wants_more() -> None:
    """That NumPy then takes one is seen in ``tests/appliance/worker/test_child.py``."""
    for given, used in (({}, "1"), ({BLAS_THREADS: "3"}, "3")):
        environment: dict[str, str] = {**given}
        use_one_blas_thread(environment)
        assert environment == {BLAS_THREADS: used}
