"""The command ``kingfisher``: a list of verbs, each of which declares its own arguments. See ``docs/cli.md``."""

from appliance.cli.main import main

__all__ = ["main"]
