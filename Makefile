# Everything from a clean clone: `make demo` and `make test` set up their own virtual environment.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
VENV := .venv
BIN := $(VENV)/bin

.PHONY: install test test-slow lint demo docs bench fuzz kills sbom proof clean

install: $(VENV)/.installed

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[test]"
	touch $@

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

test: lint
	$(BIN)/python -m pytest -n 2 --dist loadfile --durations=10

# Whole diagnoses of rarer cases, the tutorials and the first screen of the README, three quarters of an hour.
test-slow: install
	$(BIN)/python -m pytest -n 2 --durations=10 -m slow

demo: install
	$(BIN)/twin simulate mjcf/postures/milling.yaml --out out/milling
	$(BIN)/twin simulate mjcf/postures/upright.yaml --out out/upright
	$(BIN)/twin simulate mjcf/postures/rigid.yaml --out out/rigid

# The documentation as a site that needs no network: open out/site/index.html.
docs: install
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable ".[docs]"
	NO_MKDOCS_2_WARNING=1 DISABLE_MKDOCS_2_WARNING=true $(BIN)/python -m mkdocs build --strict

bench: install
	$(BIN)/python tools/benchmark.py

# Mutated inputs for every command; goes on where it stopped.
fuzz: install
	$(BIN)/python -m tools.fuzz --cases 5000 --out out/fuzz

# Kills of every command at random moments; goes on where it stopped.
kills: install
	$(BIN)/python -m tools.kills --kills 500 --out out/kills

# What the package brings along, as CycloneDX: name, version and licence of every distribution that it needs.
sbom: pyproject.toml
	$(PYTHON) -m venv out/sbom
	out/sbom/bin/python -m pip install --quiet --disable-pip-version-check .
	$(PYTHON) -m venv out/sbom-tool
	out/sbom-tool/bin/python -m pip install --quiet --disable-pip-version-check "cyclonedx-bom>=7.2,<8"
	out/sbom-tool/bin/cyclonedx-py environment --pyproject pyproject.toml --output-reproducible --of JSON -o out/sbom.json out/sbom/bin/python

# Parallel and resumable; REAL=list of measured recordings, for the page on those.
proof: install
	$(BIN)/python -m tools.trials prove --split axes --page docs/proof.md
	$(BIN)/python -m tools.trials prove --world wrong --split wrong --page docs/proof-wrong.md
	$(BIN)/python -m tools.trials prove --world arms --split arms --cases 120 --page docs/proof-arms.md
	$(if $(REAL),$(BIN)/python -m tools.trials real $(REAL) --page docs/proof-real.md)

clean:
	rm -rf $(VENV) out
