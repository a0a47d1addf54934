# Two commands do everything, set-up included:  make demo   make test
PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed

.PHONY: demo test test-long picture env lint types layers unit clean

demo: env
	$(BIN)/ppshw demo --out demo-out

# Types and layers are checked beside the tests, many of which wait for machine time.
test: lint
	$(MAKE) --jobs=2 unit types layers

# What `make test` leaves out to take about ten minutes on two cores: further cases of a diagnosis, seconds each.
test-long: env
	$(UNIT) -m long

# The README's picture, from what `make demo` left.
picture: env
	$(BIN)/python docs/img/demo_picture.py demo-out docs/img/demo.png

# Modules are compiled as they are first imported, since most of what is installed never is, and kept, since the tests
# start Python a few hundred times.
unexport PYTHONDONTWRITEBYTECODE
env: $(STAMP)
$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --no-compile -c constraints.txt -e '.[test]'
	touch $@

lint: env
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
types: env
	$(BIN)/mypy
layers: env
	$(BIN)/lint-imports
# One thread per test process: processes with two threads each would fight over two cores. Three of them,
# since many tests wait for machine time. Four are hardly faster, and a simulated drive, or run, was late now and then.
UNIT := OPENBLAS_NUM_THREADS=1 PYTHON_CPU_COUNT=1 $(BIN)/pytest -n 3 --dist worksteal
unit: env
	$(UNIT)

clean:
	rm -rf $(VENV) demo-out .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
