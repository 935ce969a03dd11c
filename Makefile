# Two commands do everything from a fresh checkout: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Test workers are processes already: threads of linear algebra in each would only wait for one another.
export OPENBLAS_NUM_THREADS := 1
export OMP_NUM_THREADS := 1
# Tests start many processes: let each read what is compiled, wherever writing it may have been turned off.
export PYTHONDONTWRITEBYTECODE :=
STAMP := $(VENV)/.installed
DEMO_STAMP := $(VENV)/.installed-demo

.PHONY: demo test lint docs slow campaigns lowest figures clean

# What the demo uses; an environment with everything has that too
demo: $(if $(wildcard $(STAMP)),$(STAMP),$(DEMO_STAMP))
	@echo "Simulating and calibrating a unit:"
	@$(BIN)/srt demo -o demo-output

test: $(STAMP)
	$(BIN)/python -m pytest -n auto --dist worksteal

# ruff, mypy strict, import rules
lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The documentation as a site; a warning is an error
docs: $(STAMP)
	$(BIN)/python -m sphinx -b html -n -W --keep-going -q docs build/docs

# Larger samples and further cases
slow: $(STAMP)
	$(BIN)/python -m pytest -n auto --dist worksteal -m 'slow and not campaign'

# The full-size statistics, and all cases of which the slow tests have a part (hours on two cores)
campaigns: $(STAMP)
	$(BIN)/python -m pytest -n auto --dist worksteal -m campaign

# Core tests with every requirement at its lower bound, and in installations without extras; makes four environments
lowest: $(STAMP)
	$(BIN)/python .ci/lowest.py

# Accuracy and speed figures of the README
figures: $(STAMP)
	$(BIN)/python benchmarks/honesty.py noise-free --units 200
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/pictures.py

$(STAMP): pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

$(DEMO_STAMP): pyproject.toml constraints.txt
	@echo "Installing what the demo uses into $(VENV): numpy, scipy, matplotlib, click, rich, pydantic"
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --disable-pip-version-check -c constraints.txt -e '.[demo]' | \
		grep --line-buffered -E '^(Collecting|Installing|Successfully)'
	touch $@

clean:
	rm -rf $(VENV) build dist demo-output *.egg-info
