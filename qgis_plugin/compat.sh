#!/usr/bin/env bash
# Runs the plugin's tests (make test-qgis) with the QGIS of other Debian releases:
#
#     sudo qgis_plugin/compat.sh [--folder DIR] [--prepare] trixie sid
#
# Each release lives in DIR/<release> (default /var/tmp/geomesh-compat; about 3 GB and ten minutes
# the first time) and is used again by the next run. --prepare builds the releases, runs no test.
# Needs root and debootstrap. Ends with one line for each release, and with 1 if one failed.
set -euo pipefail

folder=/var/tmp/geomesh-compat
prepare_only=
releases=()
while (($#)); do
    case $1 in
        --folder) folder=${2:?--folder needs a path}; shift ;;
        --prepare) prepare_only=yes ;;
        -*) sed -n '2,8s/^# \{0,1\}//p' "$0"; exit 2 ;;
        *) releases+=("$1") ;;
    esac
    shift
done
((${#releases[@]})) || { echo "Name a release, such as trixie or sid." >&2; exit 2; }
((EUID == 0)) || { echo "debootstrap and chroot need root: sudo $0 ..." >&2; exit 2; }
command -v debootstrap >/dev/null || { echo "apt-get install debootstrap" >&2; exit 2; }

checkout=$(cd "$(dirname "$0")/.." && pwd)
packages=(
    qgis python3-qgis qgis-providers python3-venv make
    xvfb xauth fonts-dejavu-core ca-certificates
)

# The mirror that this machine's apt uses, so that no host name stands here.
mirror() {
    # shellcheck disable=SC2016  # the variable is apt's
    apt-get indextargets --format '$(REPO_URI)' 'Identifier: Packages' |
        grep -E '/debian/?$' | sort -u | head -n 1
}

# The way to the network: names, proxies, certificates, settings of apt and pip.
carry_network_settings() {
    local root=$1 path
    cp -L /etc/resolv.conf "$root/etc/resolv.conf"
    for path in /etc/apt/apt.conf /etc/apt/apt.conf.d /etc/pip.conf /etc/xdg/pip \
        "$HOME/.config/pip" "$HOME/.pip"; do
        [[ -e $path ]] || continue
        mkdir -p "$root$(dirname "$path")"
        cp -rL "$path" "$root$(dirname "$path")/"
    done
    if [[ -f /etc/ssl/certs/ca-certificates.crt ]]; then
        mkdir -p "$root/etc/ssl/certs"
        cp -L /etc/ssl/certs/ca-certificates.crt "$root/etc/ssl/certs/"
    fi
}

# Runs a command inside. The mounts live in a namespace of their own and the processes in another:
# whatever way this ends, nothing stays mounted or running.
inside() {
    local root=$1 kept=()
    shift
    mapfile -t kept < <(env | grep -iE '^((https?|ftp|no|all)_proxy|PIP_(CERT|INDEX_URL|EXTRA_INDEX_URL|TRUSTED_HOST|DEFAULT_TIMEOUT)|SSL_CERT_(FILE|DIR)|REQUESTS_CA_BUNDLE)=')
    # shellcheck disable=SC2016  # these are the inner shell's variables
    setpriv --pdeathsig KILL unshare --mount --pid --fork --kill-child bash -c '
        root=$1; shift
        mount -t proc proc "$root/proc"
        mount --rbind /dev "$root/dev"
        mount -t sysfs -o ro sysfs "$root/sys"
        chroot "$root" /usr/bin/env -i "$@"' \
        inside "$root" "${kept[@]}" HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 \
        DEBIAN_FRONTEND=noninteractive "$@" </dev/null
}

prepare() {
    local release=$1 root=$folder/$1
    if [[ ! -e $root/.bootstrapped ]]; then
        rm -rf --one-file-system "$root"
        mkdir -p "$root"
        debootstrap --variant=minbase --include=ca-certificates "$release" "$root" "$(mirror)"
        touch "$root/.bootstrapped"
    fi
    carry_network_settings "$root"
    if [[ ! -e $root/.installed ]]; then
        inside "$root" apt-get update
        inside "$root" apt-get install -y --no-install-recommends "${packages[@]}"
        carry_network_settings "$root"  # the packages brought certificates of their own
        touch "$root/.installed"
    fi
}

# What git knows and what is new; not what it ignores (environments, caches).
copy_checkout() {
    local target=$1/geomesh
    mkdir -p "$target"
    # The environments stay: they take minutes, and make knows when they are out of date.
    find "$target" -mindepth 1 -maxdepth 1 ! -name '.venv*' -exec rm -rf {} +
    git -c safe.directory='*' -C "$checkout" ls-files -z --cached --others --exclude-standard |
        while IFS= read -r -d '' path; do
            [[ ! -e $checkout/$path ]] || printf '%s\0' "$path"
        done | tar -C "$checkout" --create --no-recursion --null --files-from - |
        tar -C "$target" --extract --no-same-owner
}

versions() {
    inside "$1" QT_QPA_PLATFORM=offscreen /usr/bin/python3 -c '
import platform
from qgis.core import Qgis
from qgis.PyQt.QtCore import QT_VERSION_STR
print(f"QGIS {Qgis.QGIS_VERSION.split(chr(45))[0]}, Qt {QT_VERSION_STR}, Python {platform.python_version()}")' 2>/dev/null
}

failed=0
summary=()
for release in "${releases[@]}"; do
    mkdir -p "$folder"
    log=$folder/$release.log
    # Two runs in one release would overwrite each other's checkout.
    exec 9>"$folder/$release.lock"
    flock --nonblock 9 || { echo "== $release: waiting for another run to end"; flock 9; }
    echo "== $release: preparing $folder/$release; the log is $log"
    prepare "$release" >"$log" 2>&1 || { tail -n 20 "$log"; echo "$release could not be prepared" >&2; exit 1; }
    [[ -z $prepare_only ]] || continue
    copy_checkout "$folder/$release"
    echo "== $release: make test-qgis"
    inside "$folder/$release" CI=true make -C /geomesh test-qgis PYTHON=/usr/bin/python3 \
        >>"$log" 2>&1 || { failed=1; tail -n 60 "$log"; }
    result=$(grep -aE '^=+ .*(passed|failed|error).* in [0-9.]+s.*=+$' "$log" | tail -n 1 | tr -d '=' || true)
    summary+=("$release: $(versions "$folder/$release"): ${result:-no result, see $log}")
done
((${#summary[@]} == 0)) || printf '%s\n' "${summary[@]}"
exit "$failed"
