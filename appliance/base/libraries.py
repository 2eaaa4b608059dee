"""Libraries of the desk, which may be absent: importing them, and the error where one is missing.

An instrument has none of them. So they are imported only where they are used.
"""

from __future__ import annotations

import importlib
import importlib.util
from types import ModuleType

from appliance.base.distribution import EXTRA, other_program
from appliance.base.process_start import uninterrupted


class MissingLibraryError(Exception):
    """A library of the desk is not installed; the text says which use needs it, and how to install it."""


def require(module: str, package: str, what: str) -> None:
    """Raise MissingLibraryError if ``package`` is not installed; do not import it."""
    if importlib.util.find_spec(module.partition(".")[0]) is None:
        raise MissingLibraryError(f"{what} needs {package}: pip install '{EXTRA}'")


def needed(module: str, package: str, what: str) -> ModuleType:
    """Import ``module`` of ``package``, which ``what`` (a file or a page, in words) needs.

    Raises MissingLibraryError where it is absent.
    """
    try:
        with uninterrupted():
            library: ModuleType = importlib.import_module(module)
    except ModuleNotFoundError as error:
        lacking = error.name or module
        # If the library is installed but lacks a dependency, the dependency is named.
        missing = package if lacking.partition(".")[0] == module.partition(".")[0] else lacking
        # The name alone is that of another program on PyPI, which may be the one installed.
        raise MissingLibraryError(
            "; ".join(filter(None, (f"{what} needs {missing}: pip install '{EXTRA}'", other_program())))
        ) from error
    return library
