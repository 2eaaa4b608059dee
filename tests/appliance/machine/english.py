"""Owns the keys' labels in English, as the status file has them: what tests of the machine compare with."""

from __future__ import annotations

from collections.abc import Mapping

from appliance.machine import texts
from appliance.machine.states import Machine
from appliance.machine.words import english
from drivers.api import Key


def labels(machine: Machine) -> Mapping[Key, str]:
    """What is written beside each key."""
    return {key: english(label) for key, label in texts.labels(machine).items()}
