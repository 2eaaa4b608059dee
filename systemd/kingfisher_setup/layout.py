"""Owns where everything lies on an instrument, below a root that is ``/`` or a mounted image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

PROGRAM = Path("/opt/kingfisher")
"""As the instrument itself sees it, whatever the root is now."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Paths as this process reaches them."""

    root: Path

    @property
    def live(self) -> bool:
        """This machine is the instrument: units can be started, users made."""
        return self.root == Path("/")

    def at(self, path: Path | str) -> Path:
        """An absolute path of the instrument, below the root."""
        return self.root / str(path).lstrip("/")

    @property
    def program(self) -> Path:
        return self.at(PROGRAM)

    @property
    def versions(self) -> Path:
        return self.program / "versions"

    def version(self, name: str) -> Path:
        return self.versions / name

    @property
    def current(self) -> Path:
        """The link that the service starts through."""
        return self.program / "current"

    @property
    def previous(self) -> Path:
        """The link to the version that ``rollback`` goes to."""
        return self.program / "previous"

    @property
    def rescue(self) -> Path:
        """The link to the setup and the safe screen of the last version that has proved itself."""
        return self.program / "rescue"

    @property
    def trial(self) -> Path:
        """What is on trial; the file is there only while something is."""
        return self.program / "trial.json"

    @property
    def outcome(self) -> Path:
        """How the last trial ended."""
        return self.program / "outcome.json"

    @property
    def lock(self) -> Path:
        return self.program / "lock"

    @property
    def rig(self) -> Path:
        return self.at("/etc/kingfisher/rig.toml")

    @property
    def changed(self) -> tuple[Path, ...]:
        """Everything below which a change of versions writes; data are not among it."""
        return self.program, self.at("/etc"), self.at("/usr/local")

    @property
    def data(self) -> Path:
        return self.at("/var/lib/kingfisher")

    @property
    def self_test(self) -> Path:
        """Written by the service itself when its self-test has ended."""
        return self.data / "run" / "self-test.json"
