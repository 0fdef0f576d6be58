# Everything a person does here. It needs python3 (3.11 or newer) and make; the rest comes into .venv.
PYTHON ?= python3
VENV := .venv
READY := $(VENV)/.ready
BIN := $(VENV)/bin
UV ?= $(shell uv --version >/dev/null 2>&1 && echo uv || echo $(BIN)/uv)

# uv takes the interpreter we have: it fetches none of its own.
export UV_PYTHON_DOWNLOADS := never

# The interpreter behind a shim, by its path.
EXECUTABLE := -c 'import sys; print(sys.executable)'

# A PYTHON asked for by name replaces a .venv that another one made.
IDENTITY := -c 'import sys; print(sys.base_prefix, sys.version)'
ifneq ($(origin PYTHON),file)
ifneq ($(shell $(PYTHON) $(IDENTITY) 2>&1),$(shell test -x $(BIN)/python && $(BIN)/python $(IDENTITY)))
OTHER_PYTHON := other-python
endif
endif

.PHONY: help
help:  ## this list
	@awk -F ':.*  ## ' '/^[a-z-]+:.*  ## / { printf "%-13s%s\n", $$1, $$2 }' $(MAKEFILE_LIST)

.PHONY: demo
demo: $(READY)  ## make a noisy petal, fit it, and say where the pictures are
	$(BIN)/petalfit demo

.PHONY: studio
studio: $(READY)  ## fit petals of your own in the browser
	$(BIN)/petalfit studio

.PHONY: test
test: lint  ## lint, then every test that is not slow
	$(BIN)/pytest --numprocesses auto --maxprocesses 4 --dist loadfile --no-loadscope-reorder

.PHONY: test-slow
test-slow: $(READY)  ## the slow tests alone
	$(BIN)/pytest -m slow

.PHONY: lint
lint: $(READY)  ## ruff and pyright, changing nothing
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright

.PHONY: format
format: $(READY)  ## ruff's formatting and safe fixes, in place
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

.PHONY: bench
bench: $(READY)  ## the benchmarks, about an hour; `python -m benchmarks --help` has shorter ones
	$(BIN)/python -m benchmarks --gate

.PHONY: data
data: $(READY)  ## make the cases of data_synthetic again
	$(BIN)/python -m data_synthetic

.PHONY: figures
figures: $(READY)  ## make the pictures of docs/ again
	$(BIN)/python docs/figures.py

.PHONY: gallery
gallery: $(READY)  ## make the pictures of docs/gallery.md again
	$(BIN)/python docs/gallery.py

.PHONY: docs
docs: $(READY)  ## the documentation into build/docs; every notebook is run
	$(BIN)/python -m sphinx -W -n -q -E -c docs -d build/doctrees . build/docs
	@echo "Open build/docs/index.html"

.PHONY: constraints
constraints: $(READY)  ## pin the newest versions that pyproject.toml allows
	printf 'hatchling\nuv\n' | $(UV) pip compile --quiet --upgrade --universal --python-version 3.11 \
	    --all-extras --no-annotate --custom-compile-command 'make constraints' \
	    --output-file constraints.txt pyproject.toml -

.PHONY: setup
setup: $(READY)  ## only make .venv, which the others do when they need it

.PHONY: clean
clean:  ## remove .venv and every cache
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis build dist
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# uv where it is found, or else from pip; pip alone where uv does not reach an index that pip knows.
INSTALL := --quiet --constraint constraints.txt --editable '.[dev]'
$(READY): pyproject.toml constraints.txt $(OTHER_PYTHON)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	    echo "petalfit needs Python 3.11 or newer, which '$(PYTHON)' is not: make PYTHON=..." >&2; \
	    exit 1; }
	@$(if $(OTHER_PYTHON),rm -rf $(VENV))
	@test -x $(BIN)/python \
	    || $(UV) venv --quiet --python "$$($(PYTHON) $(EXECUTABLE))" $(VENV) 2>/dev/null \
	    || $(PYTHON) -m venv $(VENV) \
	    || { rm -rf $(VENV); \
	         echo "'$(PYTHON)' cannot make $(VENV): install its venv module (on Debian" \
	              "python3-venv), or uv" >&2; exit 1; }
	@echo "Setting up $(VENV) for $$($(BIN)/python --version): a minute the first time"
	@$(UV) --version >/dev/null 2>&1 \
	    || $(BIN)/python -m pip install --quiet --constraint constraints.txt uv || true
	@$(UV) pip install --python $(BIN)/python --compile-bytecode \
	    --build-constraints constraints.txt $(INSTALL) \
	    || { echo "uv did not do it; trying pip" >&2; \
	         $(PYTHON) -m venv $(VENV) && $(BIN)/python -m pip install $(INSTALL); }
	@touch $@

.PHONY: other-python
other-python:
