#!/bin/sh
# System packages: what rendering needs, and what the tests check against. Installs them with root
# or sudo; without either it names what is missing and goes on: pictures then come from our own
# renderer, and tests against other programs are skipped with that reason.
set -u
python=${PYTHON:-python3.11}
venv=""
"$python" -c "import ensurepip" >/dev/null 2>&1 || venv="python3.11-venv"
needed="$venv libegl1 libgl1 libgl1-mesa-dri libxrender1 libglu1-mesa libxcursor1 libxinerama1 libxft2"
checkers="calculix-ccx admesh poppler-utils"
missing=""
for package in $needed $checkers; do
    state=$(dpkg-query -W -f='${Status}' "$package" 2>/dev/null) || state=""
    case "$state" in
        *" installed") ;;
        *) missing="$missing $package" ;;
    esac
done
[ -z "$missing" ] && exit 0
if ! command -v apt-get >/dev/null 2>&1; then
    echo "note: not a Debian/Ubuntu system; please install the equivalents of:$missing" >&2
    exit 0
fi
if [ "$(id -u)" = 0 ]; then
    as_root=""
elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
    as_root="sudo"
else
    echo "note: neither root nor sudo: going on without:$missing" >&2
    exit 0
fi
echo "installing:$missing"
export DEBIAN_FRONTEND=noninteractive
if ! { $as_root apt-get update -qq && $as_root apt-get install -y -qq --no-install-recommends $missing >/dev/null; }; then
    echo "note: could not install:$missing; going on without them" >&2
fi
exit 0
