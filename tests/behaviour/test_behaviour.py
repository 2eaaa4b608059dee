"""Clouds, verdicts, files and answers of every verb are those that were frozen; README.md says how what changes by decision is frozen anew."""

from __future__ import annotations

import json
import os
import tarfile
from pathlib import Path

import pytest

from tests.behaviour.frozen import RECORDINGS, SHARES, cloud_differences, frozen, processor
from tests.behaviour.outcomes import Outcome, differences, outcome_of

pytestmark = pytest.mark.timeout(900)


@pytest.fixture(scope="module")
def outcome(tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    """Everything that is made of the recordings, once."""
    folder = tmp_path_factory.mktemp("behaviour")
    with tarfile.open(RECORDINGS) as packed:
        packed.extractall(folder, filter="data")
    before = Path.cwd()
    os.chdir(folder)
    try:
        return outcome_of(folder)
    finally:
        os.chdir(before)


def test_every_answer_and_verdict_is_the_frozen_one(outcome: Outcome) -> None:
    share = SHARES[frozen().processor == processor()]
    other = list(differences(frozen().said, json.loads(json.dumps(outcome.said)), share))
    assert not other, "\n".join(other[:40])


def test_every_cloud_is_the_frozen_one(outcome: Outcome) -> None:
    wanted, exact = frozen().clouds, frozen().processor == processor()
    assert set(wanted) == set(outcome.clouds)
    other = [
        f"{name}: {said}" for name in wanted for said in cloud_differences(wanted[name], outcome.clouds[name], exact)
    ]
    assert not other, "\n".join(other)


def test_the_recordings_stay_small() -> None:
    assert RECORDINGS.stat().st_size < 10e6
