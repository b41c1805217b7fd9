# Set-up is two commands: `make demo` and `make test`. Everything is installed into .venv.
PYTHON ?= python3
BIN := .venv/bin
RUNTIME := .venv/.runtime
STAMP := .venv/.installed
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
DEMO := logs/demo
PAPERS := ./packages/tetractl-papers
IDENTIFY := ./packages/tetractl-identify
LEARN := ./packages/tetractl-learn
TESTING := ./packages/tetractl-testing
PACKAGES := $(PAPERS) $(IDENTIFY) $(LEARN) $(TESTING) ./packages/tetractl-microscope ./packages/tetractl-emulator ./packages/tetractl-toio ./packages/tetractl-motioncapture ./packages/tetractl-ros2

.PHONY: demo demo-ours demo-paper test test-fast test-ci test-all test-lowest test-newest lint dist docs rehearse clean proto

# With setuptools, a package of your own can be installed without a network: docs/how-to/extend.md.
$(RUNTIME): pyproject.toml $(PAPERS)/pyproject.toml $(IDENTIFY)/pyproject.toml $(LEARN)/pyproject.toml $(TESTING)/pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || (echo "tetractl needs Python 3.11 or later" && exit 1)
	@echo "Installing tetractl into .venv"
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@$(PIP) -e . -e $(PAPERS) -e $(IDENTIFY) -e $(LEARN) -e $(TESTING) 'setuptools>=77'
	@touch $(RUNTIME)

$(STAMP): $(RUNTIME) $(PACKAGES:%=%/pyproject.toml)
	@echo "Installing what the tests need into .venv"
	@$(PIP) -e '.[dev]' $(PACKAGES:%=-e %)
	@touch $(STAMP)

# Generates the code of the log's messages from tetractl.proto, after a change of it, by the compiler
# whose code the oldest protobuf that is allowed can read.
proto:
	@$(PYTHON) -m venv .venv/.proto
	@.venv/.proto/bin/python -m pip install --quiet --disable-pip-version-check 'grpcio-tools==1.70.*'
	.venv/.proto/bin/python -m grpc_tools.protoc -I. --python_out=. --pyi_out=. tetractl/log/format/tetractl.proto

# The reference experiment on the simulated bench: the published controller and ours in the same 20
# paired seeds, next to the published result. A second run replaces the first one's logs. The two runs
# go side by side, so that their compilations do too: on a terminal ours shows its arena live, and the
# paper's is quiet. Then come report and figures, quiet too, and at last the table.
demo: $(RUNTIME)
	@rm -rf $(DEMO) && mkdir -p $(DEMO)
	@echo "Twice 20 trials of three simulated robots: our controller, shown live, and the paper's"
	@$(MAKE) --no-print-directory -j2 demo-ours demo-paper
	@echo "Drawing the report and the figures"
	@$(MAKE) --no-print-directory -j2 $(DEMO)/report.html $(DEMO)/figure-5.png $(DEMO)/figure-3.png $(DEMO)/all-trials.png $(DEMO)/play.html
	@$(BIN)/tetractl stats $(DEMO)/ours --against $(DEMO)/paper
	@echo "Open $(DEMO)/report.html in a browser, or play a trial here: $(BIN)/tetractl replay $(DEMO)/ours/trial-000.mcap"
	@echo "Steer the robots yourself: open $(DEMO)/play.html in a browser, also on a phone"

demo-ours:
	@$(BIN)/tetractl run experiments/three_m3pi_bench.yaml --out $(DEMO)/ours >$(DEMO)/ours.txt

# Prints what a command prints only if it fails.
QUIETLY = >$(DEMO)/.$(@F) 2>&1 || { cat $(DEMO)/.$(@F); exit 1; }

demo-paper:
	@$(BIN)/tetractl run experiments/three_m3pi_paper_bench.yaml --out $(DEMO)/paper --quiet $(QUIETLY)

$(DEMO)/report.html:
	@$(BIN)/tetractl report $(DEMO)/ours $(DEMO)/paper -o $@ $(QUIETLY)

$(DEMO)/figure-5.png:
	@$(BIN)/tetractl plot $(DEMO)/ours/trial-000.mcap -o $@ $(QUIETLY)

$(DEMO)/figure-3.png:
	@$(BIN)/tetractl plot $(DEMO)/ours/trial-000.mcap --kind convergence -o $@ $(QUIETLY)

$(DEMO)/all-trials.png:
	@$(BIN)/tetractl plot $(DEMO)/ours/trial-*.mcap -o $@ $(QUIETLY)

$(DEMO)/play.html:
	@$(BIN)/tetractl play experiments/three_m3pi.yaml --html $@ $(QUIETLY)

# The tests of a file share fixtures: one process runs them. Files begin in the order of `testpaths`.
# Containers often keep Python from writing bytecode; then each process of a test compiles all anew.
unexport PYTHONDONTWRITEBYTECODE
PYTEST := -m pytest --dist loadfile --no-loadscope-reorder
ON_CORES := -n auto
# Tests in real time mostly wait: with them, one process more than there are cores.
ON_CORES_WAITING = -n $(shell $(PYTHON) -c 'import os; print(os.cpu_count() + 1)')

test: $(STAMP)
	@echo "Collecting tests, which prints nothing at first; with them, about 4 minutes on two cores"
	$(BIN)/python $(PYTEST) $(ON_CORES) -m "not long and not system"

# What needs neither other processes nor much time: for work on the code.
test-fast: $(STAMP)
	$(BIN)/python $(PYTEST) $(ON_CORES) -m "not slow and not long and not system"

# In one run what `make test` has, and of all that it leaves out what finds defects that it does not.
test-ci: $(STAMP)
	$(BIN)/python $(PYTEST) $(ON_CORES_WAITING) -m "not release"

# All that `make test` leaves out: before a release.
test-all: $(STAMP)
	$(BIN)/python $(PYTEST) $(ON_CORES_WAITING) -m "long or system"

# The tests with the lowest versions that pyproject.toml allows, and with the newest, each installed
# into an environment of its own. Half an hour each on two cores: .ci/run leaves them out.
test-lowest test-newest: test-%: $(STAMP)
	@test -x .venv-$*/bin/python || $(PYTHON) -m venv .venv-$*
	@$(BIN)/python tools/versions.py $* >.venv-$*/constraints.txt
	@.venv-$*/bin/python -m pip install --quiet --disable-pip-version-check -c .venv-$*/constraints.txt -e '.[dev]' $(PACKAGES:%=-e %)
	.venv-$*/bin/python $(PYTEST) $(ON_CORES) -m "not system" $(TESTS)

# Wheels of all packages, of the core a second one that brings its compiled code: docs/how-to/extend.md.
DIST ?= dist
dist: $(STAMP)
	@$(BIN)/python tools/dist.py $(DIST)

# All pages as a site, to be opened without a network: build/docs/docs/site/index.html.
docs: $(RUNTIME)
	@$(PIP) -e '.[docs]'
	@mkdir -p build/game
	@$(BIN)/tetractl play experiments/three_m3pi.yaml --html build/game/play.html
	@$(BIN)/python -m sphinx -W --keep-going -q -c docs/site . build/docs
	@echo "Open build/docs/docs/site/index.html in a browser"

# Days of the emulated lab with random faults, of a new seed: docs/rehearsals.md of tetractl-emulator.
DAYS ?= 200
SPEC ?= experiments/three_m3pi_lab.yaml
SEED := $(shell date +%s)
rehearse: $(STAMP)
	$(BIN)/tetractl lab rehearse $(SPEC) --days $(DAYS) --seed $(SEED) --jobs 2 --out logs/rehearsal-$(SEED)

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports
	$(BIN)/python docs/words.py

clean:
	rm -rf build .venv .venv-lowest .venv-newest .ruff_cache .import_linter_cache
