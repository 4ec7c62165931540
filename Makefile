# `make demo` and `make test` set everything up themselves, in .venv, once; set-up is repeated when
# the project file or a lock changes. Needs git, make and python3 (3.11 to 3.13), nothing else.
#
#   make demo                   the main job on bundled data, report at the end
#   make test ARGS="-k emps"    the tests; TWINPROOF_DATA names a folder with the measured data
#   make check                  format, lint, types
#   make bench                  the full benchmarks
#   make reproduce              the three published works' tables and figures, docs/reproduction
#   make docs                   the documentation, in build/docs; every link checked
#   make pages                  docs/benchmarks: the measured benchmarks; needs TWINPROOF_DATA
#   make install PYTHON=python3.12

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
WORKERS ?= 2
ARGS ?=

# Two test workers with a thread pool each would fight for the cores.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1

.PHONY: help install demo test check bench reproduce docs pages wheel lock clean distclean

help:
	@sed -n 's/^#   //p' Makefile

install: $(STAMP)

$(STAMP): pyproject.toml requirements.lock requirements-compiler.lock scripts/install.sh
	@bash scripts/install.sh "$(PYTHON)" "$(VENV)"
	@touch $@

demo: $(STAMP)
	@$(BIN)/twinproof demo $(ARGS)

test: $(STAMP)
	@$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal $(ARGS)

check: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright

bench: $(STAMP)
	@$(BIN)/python -m benchmarks $(ARGS)

reproduce: $(STAMP)
	@$(BIN)/python -m docs.reproduce $(ARGS)

docs: $(STAMP)
	@$(BIN)/python -m docs.site

pages: $(STAMP)
	@$(BIN)/python -m benchmarks.real_data $(ARGS)

wheel: $(STAMP)
	@bash scripts/try_wheel.sh "$(BIN)/python"

lock: $(STAMP)
	@bash scripts/lock.sh "$(BIN)/python"

clean:
	rm -rf build dist demo-out .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path './$(VENV)/*' -prune -exec rm -rf {} +

distclean: clean
	rm -rf $(VENV)
