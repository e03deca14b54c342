# Two commands set everything up: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
CORE := native/libtrigpoint_core.so
CORE_SOURCES := $(wildcard native/*.py native/src/*.hpp native/src/*/*.[ch]pp)
WITH_BENCH := $(VENV)/.installed-bench
SEEDS ?= 100
INPUTS ?= 1000000
SITUATIONS ?=
KINDS ?=

.PHONY: demo core fuzz wheels arm test check lint types imports bench study compositions pictures clean

demo: $(CORE)  ## the whole system on this machine, about a minute and a half
	$(BIN)/trigpoint demo --out out/demo

# Three at a time: the longest wait for processes that they started, and for time to pass.
test: $(CORE)  ## every test but the long ones, which are the study's
	$(BIN)/python -m pytest -n 3 --dist worksteal

check: lint types imports test  ## what CI runs

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/clang-format --dry-run -Werror $(filter %.cpp %.hpp,$(CORE_SOURCES))

types: $(INSTALLED)
	$(BIN)/pyright

imports: $(INSTALLED)
	$(BIN)/lint-imports

bench: $(WITH_BENCH)  ## ratios against the bare libraries
	$(BIN)/python -m benchmarks all

study: $(WITH_BENCH)  ## the long tests (stops, fire, wrong inputs and more), then accuracy over simulated sessions, to docs/background/accuracy.md; goes on where it was
	$(BIN)/python -m pytest -n 2 -m long
	-$(BIN)/python -m benchmarks study run --seeds $(SEEDS) $(or $(SITUATIONS),situations)
	-$(BIN)/python -m benchmarks study run --seeds $(SEEDS) --estimators particle,ekf $(or $(SITUATIONS),situations)
	$(MAKE) compositions

compositions: $(WITH_BENCH)  ## everything at once, as a user would calibrate it, to docs/background/compositions.md
	-$(BIN)/python -m benchmarks study run --seeds 1:$(SEEDS) $(or $(KINDS),compositions)
	$(BIN)/python -m benchmarks study report

pictures: $(CORE)  ## the README's pictures, from the demo in out/demo, by Debian's chromium
	test -e out/demo/report.html || $(MAKE) demo
	$(BIN)/python -m benchmarks.pictures.readme out/demo

core: $(CORE)  ## the compiled core, where its sources changed

$(CORE): $(CORE_SOURCES) | $(INSTALLED)
	$(BIN)/python native/build.py --strict
	touch $@

fuzz: $(CORE)  ## a million spoilt calls of the compiled core, under sanitizers (needs g++); what it finds goes to out/fuzz
	$(BIN)/python -m benchmarks fuzz --count $(INPUTS)

# For machines without a compiler, on either kind: zig builds for both, against an old C library.
wheels: $(INSTALLED)  ## wheels for x86_64 and aarch64, to dist
	for machine in x86_64 aarch64; do \
	  TRIGPOINT_WHEEL_PLATFORM=manylinux_2_28_$$machine TRIGPOINT_WHEEL_TARGET=$$machine-linux-gnu.2.28 \
	  $(BIN)/pip wheel --quiet --disable-pip-version-check --no-deps -w dist . || exit; \
	done

arm: $(CORE) wheels  ## the wheel for aarch64 under qemu finds what is found here (needs qemu-user, and pictures in ../shared/data)
	$(BIN)/python -m benchmarks arm

$(WITH_BENCH): $(CORE)
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test,bench]'
	touch $@

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Trigpoint needs Python 3.11 or later; say make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[test]'
	touch $@

clean:
	rm -rf $(VENV) out
