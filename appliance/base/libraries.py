"""Owns what is said where a library of the desk is absent: an instrument has none of them, and a computer at the desk
may.

So they are imported where they are used, by what is asked for there and by nothing else.
"""

from __future__ import annotations

import importlib
import importlib.util
from types import ModuleType

from appliance.base.distribution import EXTRA, other_program
from appliance.base.process_start import uninterrupted


class MissingLibraryError(Exception):
    """A library of the desk is not installed; the text says what it is needed for, and how to get it."""


def require(module: str, package: str, what: str) -> None:
    """Raises MissingLibraryError where ``package`` is absent, before minutes of work; nothing is imported."""
    if importlib.util.find_spec(module.partition(".")[0]) is None:
        raise MissingLibraryError(f"{what} needs {package}: pip install '{EXTRA}'")


def needed(module: str, package: str, what: str) -> ModuleType:
    """Import ``module`` of ``package``, which ``what`` (a file or a page, in words) cannot do without.

    Raises MissingLibraryError where it is absent.
    """
    try:
        with uninterrupted():
            found: ModuleType = importlib.import_module(module)
    except ModuleNotFoundError as error:
        lacking = error.name or module
        # Where the library is there and lacks something of its own, that is named, and not the library.
        missing = package if lacking.partition(".")[0] == module.partition(".")[0] else lacking
        # Whoever asked pip for `kingfisher` has got that one instead.
        raise MissingLibraryError(
            "; ".join(filter(None, (f"{what} needs {missing}: pip install '{EXTRA}'", other_program())))
        ) from error
    return found
