# make demo, test and docs work on a machine with python3 (3.11 or newer) and git:
# they build the virtual environment that they need.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
SAMPLE := data_samples/olinda_landsat7_rgb_uint8.tif

.DEFAULT_GOAL := help
.PHONY: help demo test lint bench clean

help:
	@echo "make demo    mesh a real satellite image into out/, with pictures"
	@echo "make test    run everything: pytest, ruff, mypy"
	@echo "make lint    ruff and mypy alone"
	@echo "make bench   compare speed with the peers, in one run"
	@echo "make clean   remove $(VENV), out/ and caches"

$(BIN)/.installed: pyproject.toml constraints.txt
	@echo "Building $(VENV) (a minute or two, once) ..."
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "geomesh needs Python 3.11 or newer: make PYTHON=python3.12 ..."; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --upgrade pip
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[figures]'
	@touch $@

$(BIN)/.developing: $(BIN)/.installed
	@echo "Adding what the tests need ..."
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --group test --group lint
	@touch $@

demo: $(BIN)/.installed
	@mkdir -p out
	$(BIN)/geomesh mesh $(SAMPLE) -o out/olinda.gpkg --overwrite --progress bar
	$(BIN)/geomesh stages $(SAMPLE) -o out/olinda_stages.png --overwrite
	@$(BIN)/python -c "import geomesh; \
		geomesh.read_mesh('out/olinda.gpkg').plot(path='out/olinda_mesh.png')"
	@echo
	@echo "Made from $(SAMPLE):"
	@echo "  out/olinda.gpkg        the mesh: layers triangles, edges and nodes, certified"
	@echo "  out/olinda_stages.png  what each stage of the pipeline gives"
	@echo "  out/olinda_mesh.png    the mesh on the map"
	@echo "Next:"
	@echo "  $(BIN)/geomesh quality out/olinda.gpkg       Ki and the standard measures"
	@echo "  $(BIN)/geomesh mesh your.tif -o mesh.gpkg    your own raster"
	@echo "  open out/olinda.gpkg in QGIS, or: geopandas.read_file('out/olinda.gpkg')"

test: $(BIN)/.developing
	$(BIN)/python -m pytest --numprocesses auto
	$(MAKE) --no-print-directory lint

lint: $(BIN)/.developing
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(BIN)/.developing
	$(BIN)/python -m benchmarks

clean:
	rm -rf $(VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
