# The two commands: `make demo` and `make test`. Both need Python 3.11 or newer and nothing else.
PYTHON ?= $(firstword $(shell for p in python3 python3.13 python3.12 python3.11; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p; done) python3)
BIN := .venv/bin
STAMPS := .venv/.stamps

.PHONY: help demo test slow nightly bench mutants docs site tables lint types audit tune clean

help:  ## what can be made
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/'

demo: $(STAMPS)/demo  ## install, run the suite `quick`, print its leaderboards and what to do next
	@echo "Step 3 of 3: the suite 'quick', simulated touches and presses on a real skin (some minutes)"
	$(BIN)/eitbench run quick --jobs 2
	@echo
	@echo "Next:"
	@echo "  $(BIN)/eitbench report $$(ls -td runs/quick-* | head -n 1)    # a page to look at, tables and figures for a paper"
	@echo "  $(BIN)/eitbench new-method my-method    # your own method, to be ranked beside these"
	@echo "  $(BIN)/eitbench recordings import --help    # your own data; docs/tutorials/lab.md shows the way"

# Compiled modules are kept: the tests start some hundred processes that import them.
test slow: export PYTHONDONTWRITEBYTECODE =

test: $(STAMPS)/test  ## install what tests need and run them
	$(BIN)/pytest -n auto --dist loadfile --no-loadscope-reorder

slow: $(STAMPS)/test  ## the tests of seconds to a minute, half an hour in all; a job of its own in CI
	$(BIN)/pytest -n auto --dist loadfile --no-loadscope-reorder -m "slow and not nightly"

nightly: $(STAMPS)/test  ## the tests that take minutes to hours
	$(BIN)/pytest -m nightly --timeout 3600

bench: $(STAMPS)/test  ## speed, measured beside rivals in one run (docs/speed.md)
	@mkdir -p .benchmarks
	$(BIN)/pytest tests/speed -o addopts="--import-mode=importlib" --benchmark-columns=median,iqr,rounds --benchmark-sort=name --benchmark-json=.benchmarks/last.json
	$(BIN)/python tests/speed/ratios.py .benchmarks/last.json

mutants: $(STAMPS)/mutants  ## mutation testing of what scores methods, hours (CONTRIBUTING.md)
	$(BIN)/python tests/mutation/mutate.py $(MUTANTS)

docs: $(STAMPS)/docs  ## the documentation as a site, in build/site/docs; warnings are errors
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

site: docs  ## the leaderboard in build/site, all versions, with the documentation; a page above 300 kB is an error
	$(BIN)/eitbench site reports/board --out build/site
	@! find build/site -name '*.html' -not -path '*/reports/*' -size +300000c | grep . || (echo "These pages have more than 300 kB." >&2; exit 1)

tables: $(STAMPS)/test  ## write the tables of the documentation anew, from stored runs and studies
	$(BIN)/python -m docs.tables

lint: $(STAMPS)/lint  ## ruff
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMPS)/lint $(STAMPS)/test  ## mypy, strict
	$(BIN)/mypy

audit: $(STAMPS)/audit  ## known vulnerabilities of what is installed
	$(BIN)/python tests/security/audit.py

tune: $(STAMPS)/test  ## choose packaged hyper-parameters again (an hour); those of other suites: CONTRIBUTING.md
	for suite in quick paper paper-noise noise shapes presses acuity recorded; do \
		$(BIN)/eitbench tune $$suite --jobs 2 --out benchmark/tuning/selected && \
		$(BIN)/eitbench tune $$suite --methods pyeit-jac,pyeit-greit,pyeit-bp --out benchmark/tuning/selected || exit 1; done

$(STAMPS)/venv:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "eitbench needs Python 3.11 or newer: make PYTHON=python3.x")'
	@echo "Step 1 of 3: a Python environment in .venv"
	$(PYTHON) -m venv .venv
	@mkdir -p $(STAMPS) && touch $@

$(STAMPS)/demo: $(STAMPS)/venv pyproject.toml constraints.txt
	@echo "Step 2 of 3: eitbench and its libraries go into .venv (once, some minutes; PyTorch is the largest)"
	$(BIN)/pip install -c constraints.txt -e '.[all]'
	@touch $@

$(STAMPS)/test: $(STAMPS)/demo
	$(BIN)/pip install --quiet -c constraints.txt -e '.[test]'
	$(BIN)/python tests/support/compile_solver.py
	@touch $@

$(STAMPS)/mutants: $(STAMPS)/test
	$(BIN)/pip install --quiet -c constraints.txt -e '.[mutation]'
	@touch $@

$(STAMPS)/docs: $(STAMPS)/demo
	$(BIN)/pip install --quiet -c constraints.txt -e '.[docs]'
	@touch $@

$(STAMPS)/lint: $(STAMPS)/demo
	$(BIN)/pip install --quiet -c constraints.txt -e '.[lint]'
	@touch $@

$(STAMPS)/audit: $(STAMPS)/demo
	$(BIN)/pip install --quiet -c constraints.txt -e '.[audit]'
	@touch $@

clean:  ## forget the environment and the tools' caches
	rm -rf .venv .pytest_cache .mypy_cache .ruff_cache
