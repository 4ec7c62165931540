#!/usr/bin/env bash
# Lock the newest versions that pyproject.toml allows, with hashes, for all platforms and Pythons:
# requirements.lock (run and develop) and requirements-compiler.lock (the extra `compiler`).
# Usage: scripts/lock.sh PYTHON      (a Python that has uv)
set -euo pipefail
python=$1

compile=("$python" -m uv pip compile --quiet --upgrade --universal --python-version 3.11
    --generate-hashes --no-header --no-emit-index-url)
"${compile[@]}" --group dev pyproject.toml --output-file requirements.lock
"$python" -c '
import tomllib
project = tomllib.load(open("pyproject.toml", "rb"))["project"]
print(*project["optional-dependencies"]["compiler"], sep="\n")
' | "${compile[@]}" --no-annotate - --output-file requirements-compiler.lock
