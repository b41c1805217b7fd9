# Set-up is two commands: `make demo` and `make test`. Everything is installed into .venv.
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
DEMO := logs/demo

.PHONY: demo test test-fast lint clean

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || (echo "tetractl needs Python 3.11 or later" && exit 1)
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $(STAMP)

# The reference experiment, 20 trials; a second run replaces the first one's logs.
demo: $(STAMP)
	rm -rf $(DEMO)
	$(BIN)/tetractl run experiments/three_m3pi.yaml --out $(DEMO)
	$(BIN)/tetractl plot $(DEMO)/trial-000.mcap -o $(DEMO)/figure-5.png
	$(BIN)/tetractl plot $(DEMO)/trial-*.mcap -o $(DEMO)/all-trials.png
	$(BIN)/tetractl plot $(DEMO)/trial-000.mcap --kind convergence -o $(DEMO)/figure-3.png
	@echo "Look at $(DEMO)/figure-5.png, or play a trial: $(BIN)/tetractl replay $(DEMO)/trial-000.mcap"

test: $(STAMP)
	$(BIN)/python -m pytest -n auto --dist loadgroup --no-loadscope-reorder

# What needs neither other processes nor much time: for work on the code.
test-fast: $(STAMP)
	$(BIN)/python -m pytest -n auto --dist loadgroup -m "not slow"

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports

clean:
	rm -rf .venv .ruff_cache .import_linter_cache
