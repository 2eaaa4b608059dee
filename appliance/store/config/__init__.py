"""The rig file as frozen values: ``load_rig(path) -> Rig``, or one ``ConfigError`` with the remedy."""

from appliance.store.config.load import ConfigError, default_rig_path, load_rig, parse_rig
from appliance.store.config.rig import Rig
from appliance.store.config.spell import rig_text

__all__ = ["ConfigError", "Rig", "default_rig_path", "load_rig", "parse_rig", "rig_text"]
