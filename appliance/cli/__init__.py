"""The command ``kingfisher``: arguments only; every verb calls one function. See ``docs/cli.md``."""

from appliance.cli.main import main

__all__ = ["main"]
