#!/bin/sh
# Install what debian-packages.txt lists and this machine lacks; say what to do where that is not possible.
set -eu
list=$(dirname "$0")/../debian-packages.txt
command -v dpkg-query >/dev/null || { echo "not a Debian system: install the equivalents of $list" >&2; exit 0; }
missing=
for package in $(grep -v '^#' "$list"); do
    # A tool that is there by other means (pyenv, a toolchain in /opt) is as good as the package.
    case $package in
        python3|make) command -v "$package" >/dev/null && continue ;;
        python3-venv) python3 -c 'import venv, ensurepip' 2>/dev/null && continue ;;
    esac
    dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing="$missing $package"
done
[ -z "$missing" ] && exit 0
if [ "$(id -u)" = 0 ]; then
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing
elif command -v sudo >/dev/null && sudo -n true 2>/dev/null; then
    sudo apt-get update -qq
    sudo DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing
else
    echo "missing Debian packages:$missing; install them with: apt-get install$missing" >&2
    exit 1
fi
