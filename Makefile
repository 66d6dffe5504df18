# make run   run three example studies         make test  run the tests (fast ones; `make test-slow` for the rest,
#                                              `make test-pythons` for the other versions of Python that are at hand)
# make lint  ruff and mypy                     make clean remove the environment and caches, not the results
# make docs  docs/_build/html/index.html       make docs-figures  draw the documents' figures from the studies' results
# Another interpreter: make PYTHON=python3.12 run

PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip --disable-pip-version-check
# Processes that share the tests; those of one folder stay together, and so do their fixtures.
TEST_WORKERS ?= 2
TOGETHER := -n $(TEST_WORKERS) --dist loadgroup
STUDIES := studies/four_storey_rig studies/bogie studies/hidden_bogie
# What `make run` shows: the bogies with small searches; the full ones take several minutes each.
FIRST := results/hidden_bogie/quick
SHOWN := studies/four_storey_rig 'studies/bogie --quick' 'studies/hidden_bogie --quick'
ONE_BLAS_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 MKL_NUM_THREADS=1
# Compiled tests are kept whatever the shell says: or every process compiles all of them and all of calib anew.
KEPT_BYTECODE := PYTHONDONTWRITEBYTECODE=

.PHONY: run test test-slow test-pythons lint docs docs-figures venv venv-dev clean
.DELETE_ON_ERROR:

# Each stamp is written last, so an interrupted step is done again and a finished one is skipped.
$(VENV)/.created:
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(None if (3, 11) <= v < (3, 14) else \
	    f"calib needs Python 3.11 to 3.13 and this is {v[0]}.{v[1]}; choose one with: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv --clear $(VENV)
	@touch $@

$(VENV)/.installed: $(VENV)/.created pyproject.toml constraints.txt
	$(PIP) install --quiet -c constraints.txt -e .
	@touch $@

# The oracles are compiled packages that not every platform has; the tests that use them are then skipped.
$(VENV)/.installed-dev: $(VENV)/.created pyproject.toml constraints.txt
	$(PIP) install --quiet -c constraints.txt -e '.[dev,docs,ambient,posterior,files,metamodel,workbench,cluster,metis]'
	@$(PIP) install --quiet -c constraints.txt -e '.[oracles]' \
	    || echo 'The oracles could not be installed; the tests that compare with them will be skipped.'
	@touch $(VENV)/.installed $@

$(VENV)/.installed-docs: $(VENV)/.created pyproject.toml constraints.txt
	$(PIP) install --quiet -c constraints.txt -e '.[docs]'
	@touch $(VENV)/.installed $@

venv: $(VENV)/.installed

venv-dev: $(VENV)/.installed-dev

run: $(VENV)/.installed
	@set -e; for study in $(SHOWN); do echo "calib run $$study"; $(BIN)/calib run $$study; done
	@echo; $(BIN)/python -c 'import json; told = json.load(open("$(FIRST)/record.json", encoding="utf-8")); \
	    print(*(told["analyses"]["explain"]["answer"][part] for part in ("found", "sure", "then")), sep="\n")'
	@echo; echo 'The picture of it: $(FIRST)/answer.png'; echo 'Open this page:    $(FIRST)/report.html'

test: $(VENV)/.installed-dev
	$(ONE_BLAS_THREAD) $(KEPT_BYTECODE) $(BIN)/python -m pytest $(TOGETHER) $(PYTEST_ARGS)

test-slow: $(VENV)/.installed-dev
	$(ONE_BLAS_THREAD) $(KEPT_BYTECODE) $(BIN)/python -m pytest -rs -m 'slow and not whole' $(TOGETHER) $(PYTEST_ARGS)

# Each in an environment of its own, .venv-3.12 and so on.
test-pythons:
	@.ci/pythons $(PYTHON)

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy calib

docs: $(VENV)/.installed-docs
	$(BIN)/python -m sphinx -W --keep-going -q -b html docs docs/_build/html
	@echo docs/_build/html/index.html

# A study that has run is replayed from its ledger; the vehicle's figures are drawn where its results are at hand.
docs-figures: $(VENV)/.installed
	@set -e; for study in $(STUDIES); do echo "calib run $$study"; $(BIN)/calib run "$$study"; done
	$(ONE_BLAS_THREAD) $(BIN)/python studies/solar_panel/article.py
	$(BIN)/python docs/figures.py

clean:
	rm -rf $(VENV) .venv-3.* build dist docs/_build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
