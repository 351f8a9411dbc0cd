# Every verb needs only python3 with its venv module; the rest is installed into .venv,
# at the versions constraints.txt names.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

# What `make run`, `make thesis` and `make bench` need; the other verbs add learning
# and dev tools.
RUN_EXTRAS := report,play,fast
DEV_EXTRAS := all,dev

# The matrices are small: threads of BLAS and OpenMP only get in the engine's way.
ONE_THREAD := OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1

# Options for the script or for pytest, as in: make test ARGS="-k statistics -x"
ARGS ?=

# Stamps: a file per set of installed packages, renewed when the requirements change.
CREATED := $(VENV)/.created
RUN := $(VENV)/.installed-run
DEV := $(VENV)/.installed-dev

.DELETE_ON_ERROR:
.PHONY: help run thesis docs test test-slow bench gap-suite check format size build clean

help: ## list the verbs
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' Makefile | while IFS='	' read -r verb does; do \
		printf '  make %-10s %s\n' "$$verb" "$$does"; done

run: $(RUN) ## let five agents and two constant baselines find hidden faults: a table, and a page with pictures
	$(BIN)/python scripts/agents/compare.py --page --episodes 300 --workers 1 --rows json \
		--agents greedy ppo random classical classical_literal always_healthy always_unsure $(ARGS)

thesis: $(RUN) ## run the thesis's experiments and set them beside what it printed
	$(BIN)/python scripts/reproduce_thesis.py $(ARGS)

docs: $(DEV) ## build the documentation's site into docs/_build; a warning is an error
	$(ONE_THREAD) $(BIN)/python -m sphinx -W --keep-going --quiet -j auto -b html docs docs/_build
	@echo "Open docs/_build/index.html"

# A file's tests stay in one process, which shares what its fixtures made.
test: $(DEV) ## run the tests and the examples in the docstrings
	$(ONE_THREAD) $(BIN)/python -m pytest --numprocesses auto --dist loadfile $(ARGS)

test-slow: $(DEV) ## run the slow tests: browser, killed processes, fuzzing, training, thesis, suites
	$(ONE_THREAD) $(BIN)/python -m pytest --numprocesses auto --dist loadfile -m slow --override-ini faulthandler_timeout=3600 $(ARGS)

bench: $(RUN) ## time environments, wrappers and policies beside a C loop of mj_step
	$(BIN)/python scripts/dev/benchmark.py $(ARGS)

gap-suite: $(DEV) ## grade the gap tool on blind recordings (ARGS="--numbers 0-59 --workers 2")
	$(ONE_THREAD) $(BIN)/python -m scripts.suites.gap.run $(ARGS)

check: $(DEV) ## formatting, lint and types; changes nothing
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

format: $(DEV) ## format the code and apply the safe fixes
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

size: ## print the lines of each part beside its budget
	@$(PYTHON) scripts/dev/size.py $(ARGS)

build: $(DEV) ## make the wheel and the sdist, and try each in a clean environment
	rm -rf dist
	$(BIN)/python -m build --no-isolation
	@set -e; scratch=$$(mktemp -d); trap 'rm -rf "$$scratch"' EXIT; \
	for file in dist/*.whl dist/*.tar.gz; do \
		echo "Trying $$file"; \
		$(PYTHON) -m venv --clear "$$scratch/venv"; \
		"$$scratch/venv/bin/pip" install --quiet -c constraints.txt "$$file"; \
		(cd "$$scratch" && venv/bin/python -I -W error "$(CURDIR)/scripts/dev/smoke.py"); \
	done

clean: ## remove .venv, the built files and the caches
	rm -rf $(VENV) build dist docs/_build docs/api *.egg-info .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(CREATED):
	@command -v $(PYTHON) >/dev/null || { echo "loose-env needs Python 3.11 or newer and found no $(PYTHON): install it (Debian: sudo apt install python3 python3-venv) or name it, as in: make PYTHON=/path/to/python3" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "loose-env needs Python 3.11 or newer, but $(PYTHON) is $$($(PYTHON) -V 2>&1): name a newer one, as in: make PYTHON=python3.12" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { echo "$(PYTHON) cannot make virtual environments: install its venv module (Debian: sudo apt install python3-venv)" >&2; exit 1; }
	$(PYTHON) -m venv --clear $(VENV)
	@touch $@

$(RUN): $(CREATED) pyproject.toml constraints.txt
	@echo "Installing into $(VENV); the first time takes a few minutes."
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[$(RUN_EXTRAS)]"
	@touch $@

$(DEV): $(CREATED) pyproject.toml constraints.txt
	@echo "Installing into $(VENV); the first time takes a few minutes."
	$(BIN)/python -m pip install --quiet -c constraints.txt -e ".[$(DEV_EXTRAS)]"
	@touch $@
