"""Last words of a service that ends with an error, for the safe screen, which has nothing else to go by."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from appliance.cli.failures import CONFIG, DEVICE, STORAGE, is_one_of

FILE_NAME = "last-words.json"
"""Name of the file in the service's run-time folder, which is memory: a full disk is one of the errors."""
MOST_CHARACTERS = 600


@contextmanager
def last_words(environment: Mapping[str, str]) -> Iterator[None]:
    """Write down the error that ends the block, and let it go on. Nothing where ``environment`` is not a service's."""
    folder, invocation = environment.get("RUNTIME_DIRECTORY"), environment.get("INVOCATION_ID")
    # Both are set by systemd; a person who starts the service reads the error on the terminal.
    if not folder or not invocation:
        yield
        return
    path = Path(folder.split(":")[0]) / FILE_NAME
    with suppress(OSError):
        path.unlink(missing_ok=True)  # of an earlier start
    try:
        yield
    except Exception as error:
        # With systemd's number of this start, so that the safe screen never shows the words of an earlier one.
        said = {"invocation": invocation, "kind": _kind(error), "text": _text(error)}
        with suppress(OSError):
            path.write_text(json.dumps(said) + "\n", encoding="utf-8")
        raise


def _kind(error: Exception) -> str:
    kinds = {"config": CONFIG, "storage": STORAGE, "device": DEVICE}
    return next((kind for kind, name in kinds.items() if is_one_of(error, frozenset((name,)))), "program")


def _text(error: Exception) -> str:
    said = " ".join(str(error).split())
    named = said if _kind(error) != "program" else f"{type(error).__name__}: {said}"
    return named[:MOST_CHARACTERS]
