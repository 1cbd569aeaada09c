# Two commands are enough: `make demo` and `make test`. Python >= 3.11, pip, venv and make are all that is needed.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
OUT ?= demo
WORKERS ?= 2

.PHONY: demo test test-slow validate check bench clean

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --only-binary=:all: --upgrade pip setuptools
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --prefer-binary --editable .
	touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --prefer-binary --editable ".[dev]"
	touch $@

demo: $(VENV)/.installed
	$(BIN)/monitor demo --out $(OUT)

# Two processes, each file of tests in one of them; `make test WORKERS=0` runs all in one.
test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m "not slow" -n $(WORKERS) --dist loadfile --no-loadscope-reorder

test-slow: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m slow

validate: $(VENV)/.installed-dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --prefer-binary --editable ".[validation]"
	$(BIN)/python tests/validation/validate.py $(EXPERIMENTS)

check: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(VENV)/.installed-dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --prefer-binary --editable ".[bench]"
	for file in tests/benchmarks/bench_*.py; do $(BIN)/python $$file || exit 1; done

clean:
	rm -rf $(VENV) $(OUT)
