# Set-up is two commands: `make demo` and `make test`. Everything is installed into .venv.
PYTHON ?= python3
BIN := .venv/bin
RUNTIME := .venv/.runtime
STAMP := .venv/.installed
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
DEMO := logs/demo

.PHONY: demo demo-ours demo-paper demo-statistics test test-fast test-all lint clean

# With setuptools, a package of your own can be installed without a network: docs/how-to/extend.md.
$(RUNTIME): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || (echo "tetractl needs Python 3.11 or later" && exit 1)
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(PIP) -e . 'setuptools>=77'
	touch $(RUNTIME)

$(STAMP): $(RUNTIME)
	$(PIP) -e '.[dev]'
	touch $(STAMP)

# The reference experiment on the simulated bench: the published controller and ours in the same 20
# paired seeds, next to the published result. A second run replaces the first one's logs. The two runs
# go side by side, so that their compilations do too, and so do the pictures and the statistics. Each
# line of progress begins with the run that it is of; the table of each is in a file.
demo: $(RUNTIME)
	rm -rf $(DEMO) && mkdir -p $(DEMO)
	@$(MAKE) --no-print-directory -j2 demo-ours demo-paper
	$(MAKE) --no-print-directory -j2 $(DEMO)/report.html demo-statistics $(DEMO)/figure-5.png $(DEMO)/figure-3.png $(DEMO)/all-trials.png
	@echo "Open $(DEMO)/report.html, or play a trial: $(BIN)/tetractl replay $(DEMO)/ours/trial-000.mcap"

demo-ours demo-paper: SPEC = experiments/three_m3pi_$(if $(findstring paper,$@),paper_)bench.yaml
demo-ours demo-paper:
	@echo "$(@:demo-%=%): 20 trials of $(SPEC)"
	@{ $(BIN)/tetractl run $(SPEC) --jobs $(if $(findstring paper,$@),1,2) --out $(DEMO)/$(@:demo-%=%) 2>&1 >$(DEMO)/$(@:demo-%=%).txt || touch $(DEMO)/failed; } \
	| while IFS= read -r line; do echo "$(@:demo-%=%): $$line"; done; test ! -e $(DEMO)/failed

demo-statistics:
	$(BIN)/tetractl stats $(DEMO)/ours --against $(DEMO)/paper

$(DEMO)/report.html:
	$(BIN)/tetractl report $(DEMO)/ours $(DEMO)/paper -o $@

$(DEMO)/figure-5.png:
	$(BIN)/tetractl plot $(DEMO)/ours/trial-000.mcap -o $@

$(DEMO)/figure-3.png:
	$(BIN)/tetractl plot $(DEMO)/ours/trial-000.mcap --kind convergence -o $@

$(DEMO)/all-trials.png:
	$(BIN)/tetractl plot $(DEMO)/ours/trial-*.mcap -o $@

PYTEST := $(BIN)/python -m pytest -n auto

test: $(STAMP)
	$(PYTEST) -m "not system"

# What needs neither other processes nor much time: for work on the code.
test-fast: $(STAMP)
	$(PYTEST) -m "not slow"

# The rest: real wires in real time, browser, cluster, cold compiles, pages to the last digit.
test-all: $(STAMP)
	$(PYTEST) -m system

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports
	$(BIN)/python docs/words.py

clean:
	rm -rf .venv .ruff_cache .import_linter_cache
