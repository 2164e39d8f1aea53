# One door to everything. `make help` lists the rooms.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Without isolation pip calls the maturin of the path, which need not be that of the environment.
PIP = PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/pip
RUST := $(shell find rust -name '*.rs' -not -path '*/target/*') $(shell find rust -name Cargo.toml) Cargo.toml Cargo.lock python/vhs/_core.pyi
CONFIG ?= configs/task2.yaml
ARGS ?=

.PHONY: help train test quick lint format docs bench wheel cases mujoco soak loom tsan fuzz ci clean
.DEFAULT_GOAL := help

help:  ## show this list
	@awk -F ':.*## ' '/^[a-z]+:.*## /{printf "make %-8s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

train: $(VENV)/.train $(VENV)/.built  ## train a VHS agent on Task 2, or resume it (CONFIG=..., ARGS="--set ...")
	$(BIN)/vhs train --config $(CONFIG) $(ARGS)

test: lint docs loom  ## every check: lints, types, docs, Rust tests, every interleaving of the scheduler, Python tests
	cargo test --workspace --exclude vhs-py
	$(BIN)/python -m pytest $(ARGS)

quick: $(VENV)/.dev $(VENV)/.built  ## the Python tests that take seconds, in about a minute
	$(BIN)/python -m pytest -m "not slow" $(ARGS)

lint: $(VENV)/.dev $(VENV)/.built  ## formatting, clippy, ruff, mypy, the stub against the module, docs
	cargo fmt --all --check
	cargo clippy --workspace --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --quiet
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest vhs._core --allowlist .mypy-stubtest-allowlist

format: $(VENV)/.dev  ## format the Rust and the Python code
	cargo fmt --all
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

docs: $(VENV)/.dev $(VENV)/.built  ## build the docs site into target/site; no link may be broken, no table out of date
	$(BIN)/python docs/generate.py --check
	$(BIN)/zensical build --strict

bench: $(VENV)/.dev $(VENV)/.built  ## run every benchmark; each asserts its own result first
	set -e; for file in benchmarks/bench_*.py; do $(BIN)/python $$file; done

wheel: $(VENV)/.dev  ## build the sdist, from it the wheel, and use that where there is no Rust (dist/)
	rm -rf dist
	$(BIN)/maturin sdist --out dist
	$(PIP) wheel --quiet --no-deps --no-build-isolation --wheel-dir dist dist/*.tar.gz
	$(BIN)/python .ci/check_wheel.py dist/*.whl --extra train

CASES ?= ../shared/cases
cases: $(VENV)/.dev $(VENV)/.built  ## run small programs that show faults, a line each (CASES=DIRECTORY)
	$(BIN)/python tests/run_cases.py $(CASES)

MINUTES ?= 30
soak: $(VENV)/.dev $(VENV)/.built  ## kill, stop and fill the disk of trainings, savers and pools, and count what is lost (MINUTES=30)
	$(BIN)/python tests/soak.py $(MINUTES)

# In an environment of its own: only there can MuJoCo be of another version. The oldest is the one in pyproject.toml.
MUJOCO ?= $(shell sed -n 's/.*"mujoco>=\([0-9.]*\)".*/\1/p' pyproject.toml)
OTHER := target/mujoco-$(MUJOCO)
mujoco: $(VENV)/.built  ## run the renderer's tests with another MuJoCo, the oldest that is supported (MUJOCO=VERSION)
	$(PYTHON) -m venv $(OTHER)
	$(OTHER)/bin/pip install --quiet "mujoco==$(MUJOCO)" gymnasium imageio hypothesis pytest pytest-timeout
	PYTHONPATH=python $(OTHER)/bin/python -m pytest --confcutdir=tests/raster tests/raster $(ARGS)

loom:  ## explore every interleaving of the scheduler's lock-free parts
	RUSTFLAGS="--cfg loom" CARGO_TARGET_DIR=target/loom cargo test -p vhs-rollout --release --test loom

# Unstable, hence the bootstrap variable. With the standard library built anew: in the one that is shipped the sanitiser
# does not see that a mutex for which a thread had to wait was taken (rustup component add rust-src).
tsan:  ## run the scheduler's Rust tests under ThreadSanitizer
	RUSTC_BOOTSTRAP=1 RUSTFLAGS="-Zsanitizer=thread" CARGO_TARGET_DIR=target/tsan \
		cargo test -Zbuild-std -p vhs-rollout --target x86_64-unknown-linux-gnu --test threads --test processes --test protocol

# Unstable, as above: libFuzzer's instrumentation.
fuzz:  ## fuzz what loads files, a minute each (cargo install cargo-fuzz); new inputs go to target/corpus
	set -e; for target in load_goals load_episodes; do mkdir -p target/corpus/$$target; \
		RUSTC_BOOTSTRAP=1 cargo fuzz run --fuzz-dir rust/fuzz $$target \
			target/corpus/$$target rust/fuzz/corpus/$$target -- -max_total_time=60; done

ci: test  ## what the continuous integration runs: the same as test

clean:  ## remove the environment and everything that was built
	rm -rf $(VENV) target .cache

$(BIN)/maturin:
	$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(None if v >= (3, 11) else "vhs needs Python 3.11 or newer, found %d.%d; say which one: make PYTHON=python3.11" % v)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet "maturin>=1.9.4,<2" "setuptools>=70.1"

# Stamps: .train and .dev hold what each extra brings, .built is the extension module of the present Rust sources.
$(VENV)/.train: pyproject.toml | $(BIN)/maturin
	$(PIP) install --no-build-isolation -e ".[train]"
	touch $@

$(VENV)/.dev: pyproject.toml | $(BIN)/maturin
	$(PIP) install --no-build-isolation -e ".[dev]"
	touch $@ $(VENV)/.train

$(VENV)/.built: $(RUST) | $(BIN)/maturin
	VIRTUAL_ENV=$(CURDIR)/$(VENV) $(BIN)/maturin develop --release --skip-install
	touch $@
