"""Owns a machine that is switched on: the real systemd as process 1 of its own namespaces, on a Debian in a folder.

It shares the kernel with its host and has no devices of its own. Needs root and the kernel's second cgroup hierarchy.
"""

from __future__ import annotations

import os
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType

START_S, GONE_S = 60.0, 60.0
LONG_S = 1200.0
"""A command inside: an upgrade compiles kernels."""
OUTSIDE = r"""
set -e
mount -t cgroup2 cgroup2 "$1/mnt"
mkdir "$1/mnt/$2"
echo $$ > "$1/mnt/$2/cgroup.procs"
umount "$1/mnt"
exec unshare --pid --fork --kill-child --mount --uts --ipc --net --cgroup --propagation private \
    bash -c "$3" inside "$1"
"""
INSIDE = r"""
set -e
root=$1
mount --bind "$root" "$root"
mount -t proc proc "$root/proc"
mount -t sysfs -o ro sysfs "$root/sys"
mount -t cgroup2 cgroup2 "$root/sys/fs/cgroup"
mount -t tmpfs tmpfs "$root/run"
mount -t tmpfs tmpfs "$root/tmp"
mount -t tmpfs -o mode=755 tmpfs "$root/dev"
for node in null zero full random urandom tty; do
    touch "$root/dev/$node"
    mount --bind "/dev/$node" "$root/dev/$node"
done
mkdir "$root/dev/shm" "$root/dev/pts"
mount -t tmpfs -o mode=1777 tmpfs "$root/dev/shm"
mount -t devpts -o newinstance,ptmxmode=0666,mode=0620,gid=5 devpts "$root/dev/pts"
ln -s pts/ptmx "$root/dev/ptmx"
mkdir -p "$root/run/before"
cd "$root"
pivot_root . run/before
umount --lazy run/before
exec env -i container=kingfisher PATH=/usr/sbin:/usr/bin:/sbin:/bin \
    /lib/systemd/systemd --system --log-target=journal systemd.unit=multi-user.target
"""
TIDY = r"""
mount -t cgroup2 cgroup2 "$1/mnt"
find "$1/mnt/$2" -depth -type d -exec rmdir {} + 2>/dev/null
"""


UP = ("starting", "running", "degraded")
PATH = "PATH=/usr/sbin:/usr/bin:/sbin:/bin"


class Container:
    """On while the block lasts; leaving it is a loss of power. Data stay in the folder."""

    def __init__(self, root: Path) -> None:
        self._root = root
        self._group = f"kingfisher-{os.getpid()}"

    def __enter__(self) -> Container:
        self._since_s = time.time()
        command = ["unshare", "--mount", "--propagation", "private", "bash", "-c", OUTSIDE, "outside"]
        self._outside = subprocess.Popen(
            [*command, self._root, self._group, INSIDE], stdin=subprocess.DEVNULL, start_new_session=True
        )
        try:
            self._wait_for_manager()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._outside.kill()
        self._outside.wait(30)
        command = ["unshare", "--mount", "--propagation", "private", "bash", "-c", TIDY, "tidy"]
        end_s = time.monotonic() + GONE_S
        while time.monotonic() < end_s:  # what was in the group may still be going
            subprocess.run([*command, self._root, self._group], check=False, timeout=30)
            if not self._groups():
                return
            time.sleep(0.1)
        raise AssertionError(f"processes of the machine are still there {GONE_S:g} s after it was switched off")

    def run(self, *command: object, check: bool = True) -> subprocess.CompletedProcess[str]:
        """In the machine, as root."""
        inside = ["nsenter", "--target", str(self._manager()), "--all", "--wdns=/", "env", "-i", PATH]
        done = subprocess.run(
            [*inside, *(str(word) for word in command)], capture_output=True, text=True, timeout=LONG_S, check=False
        )
        assert not check or done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
        return done

    def path(self, inside: str) -> Path:
        """A file of the running machine, its ``/dev`` and ``/run`` included."""
        return Path(f"/proc/{self._manager()}/root") / inside.lstrip("/")

    @property
    def is_off(self) -> bool:
        return self._outside.poll() is not None

    def shown(self, unit: str, what: str) -> str:
        """A property of a unit."""
        return self.run("systemctl", "show", "--value", "-p", what, unit).stdout.strip()

    def journal(self, unit: str) -> str:
        """What was said by and of a unit since the machine was switched on."""
        since = f"--since=@{self._since_s:.6f}"  # its boot is the host's
        return self.run("journalctl", since, "-u", unit, "-o", "cat", "--no-pager", "-q").stdout

    def kill(self, unit: str, number: signal.Signals) -> None:
        """To the unit's main process alone, at once."""
        self.run("systemctl", "kill", "--kill-who=main", f"--signal={number.name}", unit)

    def _manager(self) -> int:
        children = Path(f"/proc/{self._outside.pid}/task/{self._outside.pid}/children").read_text().split()
        assert len(children) == 1, f"the machine is off: {self._outside.poll()}"
        return int(children[0])

    def _wait_for_manager(self) -> None:
        end_s = time.monotonic() + START_S
        while time.monotonic() < end_s:
            assert self._outside.poll() is None, "systemd does not start here"
            with suppress(AssertionError, OSError):  # not process 1 yet
                if self.run("systemctl", "is-system-running", check=False).stdout.strip() in UP:
                    return
            time.sleep(0.2)
        raise AssertionError(f"systemd is not there after {START_S:g} s")

    def _groups(self) -> bool:
        seen = Path("/proc/self/mountinfo").read_text().splitlines()
        mounts = [Path(line.split()[4]) for line in seen if " - cgroup2 " in line]
        return any((mount / self._group).exists() for mount in mounts)
