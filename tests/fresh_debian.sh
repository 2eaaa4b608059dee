#!/usr/bin/env bash
# Proves that ./dev sets up a Debian that has nothing installed: makes one, clones HEAD into it, and runs there what a
# new user would run. Needs root, mmdebstrap and a network; takes some minutes; not part of the default test run.
#
#   tests/fresh_debian.sh [directory]     keeps base system and tree there for the next time (default: a temporary one)
#
# From the environment: MIRROR (default http://deb.debian.org/debian), SUITE (bookworm), and, carried into the fresh
# system only if set: PIP_INDEX_URL PIP_EXTRA_INDEX_URL PIP_TRUSTED_HOST http_proxy https_proxy no_proxy, and
# PIP_CERT, a file of certificates, which is copied in. TESTS: arguments of ./dev test, a line for each call (default -q);
# both stages that need packages of their own: TESTS=$'--stage=foreign\n--stage=boot'.
set -euo pipefail

repository=$(git -C "$(dirname -- "$(readlink -f -- "$0")")" rev-parse --show-toplevel)
mirror=${MIRROR:-http://deb.debian.org/debian}
suite=${SUITE:-bookworm}

fail() {
    printf 'fresh_debian: FAILED: %s\n' "$*" >&2
    exit 1
}
((EUID == 0)) || fail "a chroot needs root"
command -v mmdebstrap >/dev/null || fail "mmdebstrap is missing: apt-get install mmdebstrap"

if [[ ${FRESH_DEBIAN_INSIDE:-} != yes ]]; then # mounts of the chroot end with this namespace, however the script ends
    FRESH_DEBIAN_INSIDE=yes exec unshare --mount --propagation private -- "$0" "$@"
fi

directory=${1:-}
if [[ -z $directory ]]; then
    directory=$(mktemp -d /var/tmp/fresh-debian.XXXXXX)
    trap 'umount -R "$tree" 2>/dev/null; rm -rf --one-file-system -- "$directory"' EXIT
fi
mkdir -p -- "$directory"
directory=$(readlink -f -- "$directory")
base=$directory/$suite.tar tree=$directory/$suite

[[ -s $base ]] || mmdebstrap --quiet --variant=minbase "$suite" "$base" "$mirror"
rm -rf --one-file-system -- "$tree"
mkdir -p -- "$tree"
tar -C "$tree" -xf "$base"
mount --bind "$tree" "$tree" # a root that is a mount: whoever unshares mounts inside (the disk image's build) needs one
mount -t proc proc "$tree/proc"
mount -t sysfs -o ro sysfs "$tree/sys"
mount -t tmpfs -o mode=1777 tmpfs "$tree/dev/shm"
mount -t devpts -o newinstance,ptmxmode=0666,mode=0620,gid=5 devpts "$tree/dev/pts"
ln -sf pts/ptmx "$tree/dev/ptmx"
cp -L /etc/resolv.conf "$tree/etc/resolv.conf"
cp -L /etc/hosts "$tree/etc/hosts"

carried=(HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin TERM=dumb CI=true)
for name in PIP_INDEX_URL PIP_EXTRA_INDEX_URL PIP_TRUSTED_HOST http_proxy https_proxy no_proxy; do
    [[ -z ${!name:-} ]] || carried+=("$name=${!name}")
done
if [[ -n ${PIP_CERT:-} ]]; then
    cp -L -- "$PIP_CERT" "$tree/etc/pip-cert.pem"
    carried+=(PIP_CERT=/etc/pip-cert.pem)
fi

inside() { env -i "${carried[@]}" chroot "$tree" "$@" </dev/null; }
as_diver() { env -i "${carried[@]}" HOME=/home/diver chroot --userspec=diver:diver "$tree" "$@" </dev/null; }
failed=()
step() { printf '\n== %s\n' "$*"; }
timed() {
    local start=${EPOCHREALTIME/[.,]/}
    local status=0
    "$@" || status=$?
    took_ms=$(((${EPOCHREALTIME/[.,]/} - start) / 1000))
    printf '== took %d.%03d s\n' $((took_ms / 1000)) $((took_ms % 1000))
    return $status
}

inside useradd --create-home diver
for home in root home/diver; do git clone -q --no-local -- "$repository" "$tree/$home/kingfisher in a folder"; done
inside chown -R diver:diver /home/diver
dev="/root/kingfisher in a folder/dev" diver_dev="/home/diver/kingfisher in a folder/dev"

step "without root and sudo: says what to run"
if said=$(as_diver "$diver_dev" test 2>&1); then fail "./dev test went on without its packages: $said"; fi
printf '%s\n' "$said"
[[ $said == *"apt-get install"*libegl1* ]] || fail "no command to run in: $said"

step "root, first call: ./dev check"
timed inside "$dev" check || failed+=("./dev check")
while IFS= read -r tests; do
    step "root: ./dev test $tests"
    # shellcheck disable=SC2086 # several arguments
    timed inside "$dev" test $tests || failed+=("./dev test $tests")
done <<<"${TESTS:--q}"

step "root: ./dev demo"
timed inside "$dev" demo || failed+=("./dev demo")
ls -l "$tree/root/kingfisher in a folder/demo"

step "repeated call starts at once"
timed inside "$dev" run true
((took_ms < 2000)) || fail "a repeated call took $took_ms ms to start"

step "half-made environment: made anew"
rm -f "$tree/root/kingfisher in a folder/.venv/"{kingfisher-stamp,bin/python}
timed inside "$dev" run python -c "import appliance, cv2, genicam.genapi, glfw, hidraw, moderngl, numba, serial, usb.backend.libusb1 as usb
assert usb.get_backend() is not None, 'libusb does not load'
print(moderngl.create_context(standalone=True, backend='egl', require=330).info['GL_RENDERER'])"

step "without root, packages there: sets itself up"
timed as_diver "$diver_dev" run true

((${#failed[@]} == 0)) || fail "${failed[*]}"
step "passed"
