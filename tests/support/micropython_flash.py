"""Owns a module's flash within MicroPython's virtual machine: a file system in memory with the error numbers of the chip's.

The machine's own one has those of Emscripten, which ``mpremote`` does not know. ``micropython_serial.mjs`` mounts it.
"""

import io

NOT_THERE, THERE_ALREADY, A_FOLDER = 2, 17, 21
FOLDER, FILE = 0x4000, 0x8000


class Draft:
    """A file that is being written."""

    def __init__(self, files: dict[str, bytes], path: str) -> None:
        self._files, self._path = files, path
        files[path] = b""

    def write(self, data: bytes) -> int:
        self._files[self._path] += bytes(data)
        return len(data)

    def close(self) -> None:
        pass


class Flash:
    """What ``os.mount`` asks of a file system."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}
        self.folders = [""]
        self._here = ""

    def _at(self, path: str) -> str:
        whole = path if path.startswith("/") else self._here + "/" + path
        return "/".join([part for part in whole.split("/") if part not in ("", ".")])

    def mount(self, readonly: bool, mkfs: bool) -> None:
        pass

    def umount(self) -> None:
        pass

    def chdir(self, path: str) -> None:
        self._here = "/" + self._at(path)

    def getcwd(self) -> str:
        return self._here or "/"

    def stat(self, path: str) -> tuple[int, ...]:
        at = self._at(path)
        if at in self.folders:
            return (FOLDER, 0, 0, 0, 0, 0, 0, 0, 0, 0)
        if at not in self.files:
            raise OSError(NOT_THERE)
        return (FILE, 0, 0, 0, 0, 0, len(self.files[at]), 0, 0, 0)

    def ilistdir(self, path: str) -> object:
        at = self._at(path)
        prefix = at + "/" if at else ""
        for kind, names in ((FOLDER, self.folders), (FILE, list(self.files))):
            for name in names:
                rest = name[len(prefix) :]
                if name.startswith(prefix) and rest and "/" not in rest:
                    yield (rest, kind, 0, len(self.files.get(name, b"")))

    def mkdir(self, path: str) -> None:
        at = self._at(path)
        if at in self.folders or at in self.files:
            raise OSError(THERE_ALREADY)
        self.folders.append(at)

    def remove(self, path: str) -> None:
        if self.files.pop(self._at(path), None) is None:
            raise OSError(NOT_THERE)

    def open(self, path: str, mode: str) -> object:
        at = self._at(path)
        if at in self.folders:
            raise OSError(A_FOLDER)
        if "w" in mode:
            return Draft(self.files, at)
        if at not in self.files:
            raise OSError(NOT_THERE)
        data = self.files[at]
        return io.BytesIO(data) if "b" in mode else io.StringIO(str(data, "utf-8"))
