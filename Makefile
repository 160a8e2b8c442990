# Every target makes what it needs; a bare machine needs only make and Python 3.11 or newer with venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEFINITION := pyproject.toml setup.py $(shell find src -name "*.[ch]")
CODE := src tests benchmarks docs

# Where Python may not keep what it compiles, every process that a test starts compiles the package again.
unexport PYTHONDONTWRITEBYTECODE

# Of the tests: one more than processors, for those of live runs wait for brokers and for clocks.
TEST_WORKERS ?= $(shell $(PYTHON) -c 'import os; print(1 + os.cpu_count())')
# Of the exact campaign: plants, processes, the folder of its record, from which it is resumed, the first seed of each
# kind, and the folder of tables to which the run is added, if any.
PLANTS ?= 100000
WORKERS ?= $(shell nproc)
RECORD ?= campaign
SEED ?= 0
TABLES ?=

.PHONY: help demo quick test test-cluster test-cluster-here docs bench campaign exact-campaign mutants dist clean

help:
	@echo "make demo      diagnose three simulated tanks and leave a report page"
	@echo "make quick     style, types, and the tests of what changed, in a minute and a half"
	@echo "make test      style, types, and all tests with coverage; without it: make test COVERAGE=0"
	@echo "make test-cluster  monitors on Spark, Ray and Dask, real processes in an environment of their own; needs Java 17"
	@echo "make docs      the documentation, into docs/_build/html"
	@echo "make bench     measured speed, against other packages: the tables of the page on speed"
	@echo "make campaign  the long runs that make test leaves out"
	@echo "make mutants   guards of the evidence made wrong on purpose: what no test notices is listed, in half an hour"
	@echo "make dist      wheel and source distribution, tried out where there is no compiler"
	@echo "make clean     remove what was built (the environment $(VENV) stays)"
	@echo "make exact-campaign PLANTS=100000   generated plants against exact arithmetic; resumed where it stopped"
	@echo "Another Python: make demo PYTHON=python3.12"

# One environment; a stamp per set of extras, renewed when the definition of the package changes.
$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "residua needs Python 3.11 or newer; $(PYTHON) is: $$($(PYTHON) --version 2>&1)."; \
	  echo "Install one and name it: make $(MAKECMDGOALS) PYTHON=python3.12"; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { \
	  rm -rf $(VENV); echo "$(PYTHON) cannot make environments: install its venv module (Debian: python3-venv)."; exit 1; }

$(VENV)/.made-demo: EXTRAS := cli
$(VENV)/.made-test: EXTRAS := test
$(VENV)/.made-test-cluster: EXTRAS := test,test-cluster
$(VENV)/.made-docs: EXTRAS := docs
$(VENV)/.made-bench: EXTRAS := test,bench
$(VENV)/.made-mutants: EXTRAS := test,mutants
$(VENV)/.made-dist: EXTRAS := dist
$(VENV)/.made-%: $(BIN)/python $(DEFINITION)
	@# Only modules that are used are compiled, when they are first imported.
	$(BIN)/python -m pip install --quiet --no-compile --disable-pip-version-check --editable '.[$(EXTRAS)]'
	@touch $@

demo: $(VENV)/.made-demo
	$(BIN)/residua demo three-tank

quick: $(VENV)/.made-test
	$(BIN)/python tests/quick.py $(if $(SINCE),--since $(SINCE))

test: $(VENV)/.made-test
	$(BIN)/ruff check $(CODE)
	$(BIN)/ruff format --check $(CODE)
	@# Types beside the tests, and what they say after them.
	$(BIN)/pyright --pythonpath $(BIN)/python > $(VENV)/types.log 2>&1 & types=$$!; \
	$(BIN)/pytest -n $(TEST_WORKERS) --dist worksteal $(if $(filter 0,$(COVERAGE)),,--cov --cov-report=); tests=$$?; \
	$(if $(filter 0,$(COVERAGE)),,$(BIN)/coverage report;) \
	wait $$types; typed=$$?; cat $(VENV)/types.log; exit $$((tests + typed))

# In an environment of its own: the engines are large, and take an older pandas than the other tests.
test-cluster:
	$(MAKE) VENV=$(VENV)-cluster test-cluster-here

test-cluster-here: $(VENV)/.made-test-cluster
	$(BIN)/pytest -n 0 tests/cluster

docs: $(VENV)/.made-docs
	$(BIN)/python docs/make_picture.py
	rm -rf docs/api/generated  # pages of names that are gone would fail the build
	$(BIN)/python -m sphinx -E -W --keep-going -q -b html docs docs/_build/html  # without -E the search loses index entries
	@echo "docs/_build/html/index.html"

bench: $(VENV)/.made-bench
	$(BIN)/python benchmarks/other_packages.py --out docs/data
	$(BIN)/python benchmarks/fused_speed.py --out docs/data/speed.csv
	$(BIN)/python benchmarks/design_times.py --out docs/data/design_times.csv
	$(BIN)/python benchmarks/design_ratios.py --out docs/data/design_ratios.csv
	$(BIN)/pytest benchmarks -s --benchmark-columns=min,median,ops --benchmark-sort=min

campaign: $(VENV)/.made-test
	$(BIN)/pytest -m campaign

exact-campaign: $(VENV)/.made-test
	OPENBLAS_NUM_THREADS=1 PYTHONPATH=src:tests $(BIN)/python -m exact_campaign \
	  --plants $(PLANTS) --seed $(SEED) --workers $(WORKERS) --out $(RECORD) $(if $(TABLES),--tables $(TABLES))

mutants: $(VENV)/.made-mutants
	$(BIN)/python tests/mutants.py

dist: $(VENV)/.made-dist
	rm -rf dist
	$(BIN)/python -m build --outdir dist
	$(BIN)/python tests/distribution.py dist

clean:
	rm -rf build dist htmlcov .coverage .benchmarks .pytest_cache .hypothesis .ruff_cache residua-demo
	rm -rf docs/_build docs/gallery docs/api/generated docs/sg_execution_times.rst
	find src tests benchmarks docs -name __pycache__ -type d -prune -exec rm -rf {} +
