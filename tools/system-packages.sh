#!/bin/sh
# System packages: what rendering needs, and what the tests check against. Installs them with root
# or sudo; without either it names what is missing and goes on: pictures then come from our own
# renderer, and tests against other programs are skipped with that reason. With the word `venv`,
# only what $PYTHON needs to make a virtual environment.
set -u
needed="libegl1 libgl1 libgl1-mesa-dri libxrender1 libglu1-mesa libxcursor1 libxinerama1 libxft2"
checkers="calculix-ccx admesh poppler-utils"
if [ "${1:-}" = venv ]; then
    python=${PYTHON:-python3}
    "$python" -c "import ensurepip" >/dev/null 2>&1 && exit 0
    needed="$(basename "$python")-venv"
    checkers=""
fi
missing=""
for package in $needed $checkers; do
    state=$(dpkg-query -W -f='${Status}' "$package" 2>/dev/null) || state=""
    case "$state" in
        *" installed") ;;
        *) missing="$missing $package" ;;
    esac
done
# Any browser of the kind does for tests of the pages; not every Ubuntu has Debian's package.
browser=""
[ "${1:-}" = venv ] || command -v chromium >/dev/null 2>&1 || command -v chromium-browser >/dev/null 2>&1 ||
    command -v google-chrome >/dev/null 2>&1 || browser=" chromium"
[ -z "$missing$browser" ] && exit 0
if ! command -v apt-get >/dev/null 2>&1; then
    echo "note: not a Debian/Ubuntu system; please install the equivalents of:$missing$browser" >&2
    exit 0
fi
if [ "$(id -u)" = 0 ]; then
    as_root=""
elif command -v sudo >/dev/null 2>&1 && sudo -n true 2>/dev/null; then
    as_root="sudo"
else
    echo "note: neither root nor sudo: going on without:$missing$browser" >&2
    exit 0
fi
echo "installing:$missing$browser"
export DEBIAN_FRONTEND=noninteractive
$as_root apt-get update -qq
for group in "$missing" "$browser"; do
    if [ -n "$group" ] && ! $as_root apt-get install -y -qq --no-install-recommends $group >/dev/null; then
        echo "note: could not install:$group; going on without" >&2
    fi
done
exit 0
