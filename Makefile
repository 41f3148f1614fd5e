# Needs Python 3.10 or newer, a Rust toolchain with rustfmt and clippy, and make. Everything else goes into .venv.
#
#   make test      lint, Rust tests, the source distribution in an empty environment, Python tests, the pages
#   make test-fast formatting, clippy, ruff, mypy, Rust unit tests, and the Python tests that are not marked slow
#   make lint      formatting, clippy, rustdoc, ruff, import-linter, mypy, stubtest
#   make demo      simulate the stand, calibrate, judge, and write a page to demo/
#   make bench     speed compared with SciPy, start time, growth and memory, simulation, and Allan deviations
#   make comparison  accuracy and speed compared with other programs, to docs/comparison.md; needs crates.io and PyPI
#   make accuracy  Monte Carlo accuracy over the theoretical bounds, to docs/results/accuracy.md, and of noise figures
#   make six-positions  coverage of bias and scale from six positions, to docs/results/six-positions.md
#   make one-sensor  coverage and errors of an accelerometer or a gyroscope alone, to docs/results/one-sensor.md
#   make rounding  coverage of the intervals with noise below a step of the converter, to docs/results/rounding.md
#   make faces     coverage and errors of a unit that rests on the faces of a box alone, to docs/results/faces.md
#   make gap-benchmark  blind test with hidden effects, to docs/results/gap.md; SHARE=0.1 runs a tenth
#   make laws-benchmark  errors that the catalogue lacks, to docs/results/laws.md
#   make units-benchmark  strong effects, variations in time, two sessions, to docs/results/units.md
#   make thermal-benchmark  sensors that remember the temperature, to docs/results/thermal.md
#   make plan      planned standard deviations over those of simulated runs, to docs/results/plan.md
#   make traps     inputs that easily give a wrong result, and 500 clean runs, to docs/results/traps.md
#   make results   all pages of results that need no other tools than this Makefile installs; takes hours
#   make mutants   deliberate errors that tests should find, to docs/results/mutants.md; ONLY=rust; takes hours
#   make copies    altered copies of a recording as its control, to docs/results/copies.md
#   make signals   time from Ctrl-C to the end of each long command, to docs/results/signals.md
#   make firmware  the C code on Cortex-M4F, M0+ and RV32 under QEMU, to docs/results/firmware.md
#   make fuzz      damaged files of every format for MINUTES=30, then arbitrary recordings with cargo-fuzz
#   make stand-driver  faults of a stand with a GRBL controller, to docs/results/stand-driver.md; GRBL_SIM=path
#   make stand-firmware  a whole calibration on firmware, to docs/results/stand-firmware.md; GRBL_SIM=path
#   make stand     verdicts of a simulated line for good units and hidden faults, to docs/results/stand.md
#   make test-firmware  faults of a stand on a simulator of GRBL or grblHAL: GRBL_SIM=path, see docs/stand.md
#   make fleet     a simulated fleet, its speed, store and kills, to docs/results/fleet.md; PARTS=kills runs one part
#                  accuracy, plan, gap-, laws-, units- and thermal-benchmark go on where they were killed; SCHEDULER=tcp://HOST:8786 for Dask
#   make test-vectors  README and tutorial with the arithmetic of AVX2 and of AVX-512, also on a processor without it
#   make docs      the pages under docs/ as a site, site/index.html; a broken link is an error
#   make docs-figures  one picture of each effect, to docs/effects/; convergence, to docs/results/convergence.md
#   make docs-pictures  screenshots of a report, to docs/pictures; needs Chromium
#   make wheel     dist/*.whl
#   make wheel-manylinux  a wheel for manylinux2014, linked by zig and tried in another Python: OTHER_PYTHON=path
#   make format    format Rust and Python
#   make clean     remove .venv and dist; target/ stays, because its dependencies take minutes to build

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PY := $(BIN)/python

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
MAKEFLAGS += --no-builtin-rules

# One target folder and one profile for tests, benchmarks, wheel and sdist, so that dependencies are built once.
export CARGO_TARGET_DIR ?= $(CURDIR)/target
export PYO3_PYTHON := $(CURDIR)/$(PY)
export PIP_DISABLE_PIP_VERSION_CHECK := 1

# Always the whole workspace: cargo unifies the features of the packages that it builds together, and another set of
# features compiles the dependencies again.
CARGO_TEST := cargo test --release --locked --workspace

MANIFESTS := Cargo.toml Cargo.lock pyproject.toml README.md LICENSE-MIT LICENSE-APACHE THIRD_PARTY_LICENSES
RUST_SOURCES := $(shell find rust -type f)
PYTHON_SOURCES := $(shell find python -type f -not -path '*/__pycache__/*' -not -name '*.so')
SOURCES := $(MANIFESTS) $(RUST_SOURCES) $(PYTHON_SOURCES)

say = @printf '\n== %s\n' '$(1)'

.PHONY: help
help:
	@sed -n 's/^#   //p' Makefile

# --- environment -------------------------------------------------------------------------------------------------

# Dependency groups need pip 25.1.
$(VENV)/.tools: pyproject.toml
	$(call say,Set up $(VENV))
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "Python 3.10 or newer is needed: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)
	$(PY) -m pip install --quiet --upgrade 'pip>=25.1'
	$(PY) -m pip install --quiet --group dev
	@touch $@

.PHONY: rust-components
rust-components:
	@cargo --version >/dev/null || { echo "cargo is missing: install a Rust toolchain, see https://rustup.rs"; exit 1; }
	@cargo fmt --version >/dev/null 2>&1 || { echo "rustfmt is missing: rustup component add rustfmt"; exit 1; }
	@cargo clippy --version >/dev/null 2>&1 || { echo "clippy is missing: rustup component add clippy"; exit 1; }

# --- wheel -------------------------------------------------------------------------------------------------------

.PHONY: wheel installed
wheel: dist/.wheel
installed: $(VENV)/.installed

dist/.wheel: $(SOURCES) | $(VENV)/.tools
	$(call say,Build the wheel)
	@rm -f dist/*.whl
	$(BIN)/maturin build --release --locked --interpreter $(PY) --out dist
	@touch $@

# pip keeps an installed package of the same version, so the old one is removed first.
$(VENV)/.installed: dist/.wheel $(VENV)/.tools
	$(call say,Install the wheel)
	@$(PY) -m pip uninstall -qq --yes imucal-rs
	$(PY) -m pip install --quiet "$$(echo dist/*.whl)[report]"
	@touch $@

# Old versions of Linux run what zig links against their C library. The wheel is tried in an empty environment of
# another Python than that of .venv, with a calibration.
OTHER_PYTHON ?= /usr/bin/python3
.PHONY: wheel-manylinux
wheel-manylinux: $(VENV)/.tools
	$(call say,Build a wheel for manylinux2014 and install it for $(OTHER_PYTHON))
	$(PY) -m pip install --quiet --group release
	@rm -rf dist/manylinux
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/maturin build --release --locked --zig --compatibility manylinux2014 \
		--interpreter $(PY) --out dist/manylinux
	$(BIN)/twine check --strict dist/manylinux/*.whl
	$(OTHER_PYTHON) -m venv --clear $(CARGO_TARGET_DIR)/manylinux-venv
	$(CARGO_TARGET_DIR)/manylinux-venv/bin/python -m pip install --quiet dist/manylinux/*.whl
	$(CARGO_TARGET_DIR)/manylinux-venv/bin/python tests/package/wheel_smoke.py

# The library with this feature is larger by half, so it is built beside that of the wheel.
.PHONY: test-vectors
test-vectors: $(VENV)/.installed
	$(call say,Compare the digits of AVX2 and AVX-512)
	@rm -rf dist/vectors $(CARGO_TARGET_DIR)/vectors
	$(BIN)/maturin build --release --locked --features emulate-avx512 --interpreter $(PY) --out dist/vectors
	$(PY) -m pip install --quiet --no-deps --target $(CARGO_TARGET_DIR)/vectors dist/vectors/*.whl
	PYTHONPATH=$(CARGO_TARGET_DIR)/vectors $(PY) -m pytest -q tests/docs/test_processors.py

# --- lint --------------------------------------------------------------------------------------------------------

.PHONY: lint lint-fast lint-rust lint-python lint-documentation lint-stub format
lint: lint-fast lint-documentation lint-stub
lint-fast: lint-rust lint-python

lint-rust: rust-components $(VENV)/.tools
	$(call say,Rust: formatting)
	cargo fmt --all --check
	$(call say,Rust: clippy)
	cargo clippy --workspace --all-targets --locked -- -D warnings
	$(call say,Rust: licences)
	$(PY) tests/package/licences.py
	@PATH="$(CURDIR)/$(BIN):$$PATH"; \
	if ! cargo deny --version >/dev/null 2>&1; then \
	  echo "sources and advisories are not checked: cargo install cargo-deny"; exit 0; fi; \
	cargo deny --offline --locked check licenses bans sources; \
	if timeout 60 cargo deny fetch db >/dev/null 2>&1; then cargo deny --locked check advisories; \
	  else echo "advisories are not checked: their database at github.com is out of reach"; fi

lint-documentation: rust-components $(VENV)/.tools
	$(call say,Rust: documentation)
	RUSTDOCFLAGS='-D warnings' cargo doc --workspace --no-deps --locked

PYTHON_FILES := $(wildcard python tests benches examples) docs/site_hooks.py

lint-python: $(VENV)/.installed
	$(call say,Python: formatting and lint)
	$(BIN)/ruff format --check $(PYTHON_FILES)
	$(BIN)/ruff check $(PYTHON_FILES)
	$(call say,Comments and pages: length of lines)
	$(PY) tests/package/line_length.py
	$(call say,Python: layers)
	$(BIN)/lint-imports --no-cache
	$(call say,Python: types)
	$(PY) -m mypy

# The check depends on the installed package alone, and type-checks all that the stub imports each time.
lint-stub: $(VENV)/.stub
$(VENV)/.stub: $(VENV)/.installed
	$(call say,Python: the stub agrees with the extension)
	$(PY) -m mypy.stubtest imucal._core
	@touch $@

format: rust-components $(VENV)/.tools
	cargo fmt --all
	$(BIN)/ruff format $(PYTHON_FILES)
	$(BIN)/ruff check --fix $(PYTHON_FILES)

# --- tests -------------------------------------------------------------------------------------------------------

.PHONY: test test-fast test-rust test-rust-fast test-sdist test-python test-python-fast
# The pages are built by tests/docs/test_site.py.
test: lint test-rust test-sdist test-python
test-fast: lint-fast test-rust-fast test-python-fast

test-rust: rust-components
	$(call say,Rust: tests and documentation tests)
	$(CARGO_TEST)

test-rust-fast: rust-components
	$(call say,Rust: unit tests)
	$(CARGO_TEST) --lib

test-sdist: $(VENV)/.sdist

# The empty environment has no development tools in it: what the package needs, it must bring. Its test is small because
# the wheel is tested in full.
$(VENV)/.sdist: $(SOURCES) tests/package/sdist_smoke.py | $(VENV)/.tools
	$(call say,Build the sdist and install it into an empty environment)
	@rm -f dist/*.tar.gz
	$(BIN)/maturin sdist --out dist
	$(PYTHON) -m venv --clear $(CARGO_TARGET_DIR)/sdist-venv
	$(CARGO_TARGET_DIR)/sdist-venv/bin/python -m pip install --quiet dist/*.tar.gz
	$(CARGO_TARGET_DIR)/sdist-venv/bin/python tests/package/sdist_smoke.py
	@touch $@

# Tests with a common costly fixture stay in one process (tests/conftest.py). Two processes more than processors, because
# tests wait for other programs. Compiled test files are kept, or each process would compile all of them.
PYTEST = PYTHONDONTWRITEBYTECODE= $(PY) -m pytest --dist loadgroup --no-loadscope-reorder \
	--numprocesses $$($(PY) -c 'import os; print(2 + (os.cpu_count() or 1))')
test-python: $(VENV)/.installed
	$(call say,Python: tests against the installed wheel)
	$(PYTEST)

test-python-fast: $(VENV)/.installed
	$(call say,Python: tests that are not slow)
	$(PYTEST) -m 'not slow'

# Each simulator keeps a processor busy, and needs another one at times, so two processors for each.
FIRMWARE_AT_ONCE ?= 1
.PHONY: test-firmware
test-firmware: $(VENV)/.installed
	$(call say,Stand: faults on the firmware of a controller)
	GRBL_SIM="$(GRBL_SIM)" $(PY) -m pytest tests/stand/test_firmware.py --numprocesses $(FIRMWARE_AT_ONCE)

# --- pages -------------------------------------------------------------------------------------------------------

# The warning that it silences is about the next major versions; pyproject.toml keeps them out.
.PHONY: docs
docs: $(VENV)/.installed
	$(call say,Pages)
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --quiet

# --- what it can do ----------------------------------------------------------------------------------------------

.PHONY: demo bench accuracy rounding faces six-positions one-sensor gap-benchmark laws-benchmark units-benchmark thermal-benchmark plan traps copies signals stand first-steps mutants results
.PHONY: docs-figures docs-pictures fleet stand-driver stand-firmware firmware comparison
# Stops at the first page that cannot be made, and after a plan that misses a gate. Finished answers of simulated cases
# are not computed again.
results: accuracy six-positions one-sensor rounding faces gap-benchmark laws-benchmark units-benchmark \
		thermal-benchmark plan traps copies stand fleet signals bench docs-figures

demo: $(VENV)/.installed
	$(call say,Demo)
	$(BIN)/imucal demo

bench: $(VENV)/.installed
	$(call say,Speed)
	$(PY) benches/compare.py
	$(PY) benches/start.py
	$(PY) benches/reading.py
	$(PY) benches/scaling.py
	$(PY) benches/gap_speed.py
	$(PY) benches/simulate.py
	$(PY) benches/allan.py

comparison: $(VENV)/.installed
	$(PY) benches/comparison.py

# These go on where they were killed, and run on a Dask cluster: make accuracy SCHEDULER=tcp://HOST:8786
ENGINE = $(if $(SCHEDULER),--scheduler $(SCHEDULER))

accuracy: $(VENV)/.installed
	$(call say,Accuracy)
	PYTHONPATH=benches $(PY) -m accuracy $(ENGINE)
	$(PY) benches/noise_accuracy.py $(ENGINE)
	$(PY) benches/noise_steps.py $(ENGINE)

six-positions: $(VENV)/.installed
	PYTHONPATH=benches $(PY) benches/six_positions.py

one-sensor: $(VENV)/.installed
	$(call say,One sensor)
	PYTHONPATH=benches $(PY) benches/one_sensor.py

rounding: $(VENV)/.installed
	$(call say,Rounding)
	PYTHONPATH=benches $(PY) benches/rounding.py

faces: $(VENV)/.installed
	$(call say,A box on its faces)
	PYTHONPATH=benches $(PY) benches/faces.py

SHARE ?= 1
gap-benchmark: $(VENV)/.installed
	$(call say,Hidden effects)
	PYTHONPATH=benches $(PY) -m gap --share $(SHARE) $(ENGINE)

laws-benchmark: $(VENV)/.installed
	$(call say,Laws)
	PYTHONPATH=benches $(PY) -m gap.laws $(ENGINE)

units-benchmark: $(VENV)/.installed
	$(call say,Units)
	PYTHONPATH=benches $(PY) -m gap.units $(ENGINE)

thermal-benchmark: $(VENV)/.installed
	$(call say,Sensors that remember the temperature)
	PYTHONPATH=benches $(PY) -m gap.thermal $(ENGINE)

first-steps: $(VENV)/.installed
	$(call say,From a clone to a C header)
	$(PY) benches/first_steps.py

plan: $(VENV)/.installed
	$(call say,Plans)
	PYTHONPATH=benches $(PY) -m plan $(ENGINE)

traps: $(VENV)/.installed
	$(call say,Traps)
	PYTHONPATH=benches:tests/traps:tests/fixtures $(PY) benches/traps.py

# The tests need the clone, and the folder of shared recordings beside it.
mutants: $(VENV)/.installed rust-components
	$(call say,Deliberate errors)
	PYTHONPATH=benches $(PY) -m mutants $(if $(ONLY),--language $(ONLY))

copies: $(VENV)/.installed
	$(call say,Copies as control recordings)
	PYTHONPATH=benches $(PY) benches/copies.py

firmware: $(VENV)/.installed
	$(call say,Firmware under QEMU)
	PYTHONPATH=benches $(PY) -m firmware

signals: $(VENV)/.installed
	$(call say,Signals)
	$(PY) benches/signals.py

stand-driver: $(VENV)/.installed
	$(call say,Faults of a stand)
	GRBL_SIM="$(GRBL_SIM)" PYTHONPATH=tests/fixtures $(PY) benches/stand_driver.py

stand-firmware: $(VENV)/.installed
	$(call say,A calibration on firmware)
	GRBL_SIM="$(GRBL_SIM)" PYTHONPATH=tests/fixtures $(PY) benches/stand_firmware.py

stand: $(VENV)/.installed
	$(call say,Units on the line)
	$(PY) benches/stand_line.py

PARTS ?= planted,speed,storage,poisoned,kills
fleet: $(VENV)/.installed
	$(call say,Many units)
	PYTHONPATH=benches $(PY) -m fleet --parts $(PARTS)

docs-figures: $(VENV)/.installed
	$(call say,Figures of the documentation)
	$(PY) benches/convergence.py
	$(PY) benches/effects_gallery.py

docs-pictures: $(VENV)/.installed
	$(call say,Screenshots of a report)
	$(PY) benches/report_pictures.py

# Damaged files and arbitrary recordings, from new random numbers on each call with another SEED. cargo-fuzz needs a
# nightly toolchain; without it, `make test` runs the same targets with seeded numbers.
MINUTES ?= 30
SEED ?= 1000000
FUZZ_TARGETS := check inspect calibrate stored
.PHONY: fuzz
fuzz: $(VENV)/.installed
	$(call say,Damaged files)
	PYTHONPATH=tests/fuzz:tests/fixtures $(PY) tests/fuzz/run.py --minutes $(MINUTES) --first-seed $(SEED)
	$(call say,Arbitrary recordings)
	@if ! cargo +nightly fuzz --version >/dev/null 2>&1; then echo "left out: cargo install cargo-fuzz, rustup toolchain install nightly"; else \
	  for target in $(FUZZ_TARGETS); do \
	    cargo +nightly fuzz run $$target -- -max_total_time=$$(( 60 * $(MINUTES) )) -timeout=10 -rss_limit_mb=2048; \
	  done; fi

.PHONY: clean
clean:
	rm -rf $(VENV) dist demo site
