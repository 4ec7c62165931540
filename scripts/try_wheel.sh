#!/usr/bin/env bash
# Build the wheel and use it as a newcomer would: in a new environment, away from the checkout.
# Usage: scripts/try_wheel.sh PYTHON      (a Python that has `build`)
set -euo pipefail
python=$1

fail() {
    printf 'wheel: %s\n' "$@" >&2
    exit 1
}

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$python" -m build --wheel --outdir "$work/dist" . >"$work/build.log" 2>&1 || {
    cat "$work/build.log" >&2
    fail "it does not build"
}
wheel=$(echo "$work"/dist/*.whl)

"$python" -m zipfile --list "$wheel" >"$work/names"
for needed in Twinproof/package.mo demo_data/balancing.blf demo_data/held_out.blf LICENSE \
    twin/pages/static/twin.js twin/store/migrations/versions/0001_log.py \
    workbench/static/index.html workbench/static/vendor/uPlot.min.js; do
    grep -q "$needed" "$work/names" || fail "$needed is not in it"
done
if grep -E '^(tests|benchmarks|examples|docs)/' "$work/names"; then
    fail "it has files that are for the checkout only"
fi

# The locked versions, without hashes: pip would demand one for the wheel itself too.
grep -hE '^[a-z0-9].*==' requirements.lock requirements-compiler.lock | sed 's/ \\$//' \
    >"$work/constraints.txt"
extra=
if ! command -v cc >/dev/null && ! command -v gcc >/dev/null && ! command -v clang >/dev/null; then
    extra='[compiler]'
fi
"$python" -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check \
    --constraint "$work/constraints.txt" "$wheel$extra"
"$work/venv/bin/python" -m pip check

cd "$work"
export PATH="$work/venv/bin:$PATH"
unset PYTHONPATH TWINPROOF_DATA
step() {
    echo "wheel: $*"
    "$@" >out.txt 2>&1 || {
        cat out.txt >&2
        fail "this failed: $*"
    }
    [ -s out.txt ] || [ "$1" = python ] || fail "this printed nothing: $*"
}
step twinproof --version
step twinproof effects
step python -W error -c 'import twinproof'
step twinproof export Twinproof.Plants.Pendulum -o pendulum.fmu
step twinproof check pendulum.fmu
step twinproof simulate pendulum.fmu --stop 1 --step 0.01 -o pendulum.csv
rows=$(wc -l <pendulum.csv)
[ "$rows" -ge 100 ] || fail "the simulation wrote $rows lines, not a hundred"
echo "wheel: $(basename "$wheel") works in a clean environment"
