#!/usr/bin/env bash
# Set up a virtual environment with the locked packages and this package, editable.
# Usage: scripts/install.sh PYTHON VENV
set -euo pipefail
python=$1 venv=$2

fail() {
    printf 'install: %s\n' "$@" >&2
    exit 2
}

command -v "$python" >/dev/null ||
    fail "there is no $python; install Python 3.11 to 3.13, or name one: make install PYTHON=..."
"$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' ||
    fail "$("$python" --version) is not 3.11 to 3.13; install one and name it: make install PYTHON=python3.12"
"$python" -c 'import ensurepip, venv' 2>/dev/null ||
    fail "$python cannot make virtual environments; on Debian or Ubuntu: apt install python3-venv"

# An environment whose pip does not run is the rest of an interrupted attempt: start again.
if ! "$venv/bin/python" -m pip --version >/dev/null 2>&1; then
    echo "install: making $venv"
    "$python" -m venv --clear "$venv"
fi

pip=("$venv/bin/python" -m pip install --quiet --disable-pip-version-check)
echo "install: the locked packages (a few minutes the first time)"
"${pip[@]}" --require-hashes -r requirements.lock
if ! command -v cc >/dev/null && ! command -v gcc >/dev/null && ! command -v clang >/dev/null; then
    echo "install: no C compiler found, so the one from PyPI too"
    "${pip[@]}" --require-hashes -r requirements-compiler.lock
fi
"${pip[@]}" --no-deps --editable .
