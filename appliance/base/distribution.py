"""The name of this program at pip, and a check for another program of the same import name.

`kingfisher` on PyPI is a program for DNA reads. It has the same command and the same import name, so that of the two
the one that was installed last is called, and the files of both lie in one folder. That is why this program has another
name there.
"""

from __future__ import annotations

from pathlib import Path

DISTRIBUTION = "kingfisher-3d"
"""The name in ``pyproject.toml``."""
EXTRA = f"{DISTRIBUTION}[desk]"
"""The extra of ``pyproject.toml`` that has all libraries of the desk."""
_OTHER = "kingfisher"
_OURS = Path(__file__).parents[1].name


def other_program() -> str | None:
    """Return one sentence about an installed distribution that shadows ours; ``None``: there is none."""
    from importlib import metadata  # late: it takes longer to load than the rest of `kingfisher --version`

    try:
        installed = metadata.distribution(_OTHER)
    except metadata.PackageNotFoundError:
        return None
    if _OURS in (installed.read_text("top_level.txt") or "").split():
        return None  # this program, as it was called before
    return (
        f"another program called kingfisher ({installed.version}: {installed.metadata['Summary'] or 'no summary'}) is "
        "installed here and has the "
        f"same command and import name: pip uninstall {_OTHER}, then install {DISTRIBUTION} again"
    )
