# make demo, test and docs need only python3 (3.11 or newer) and git. They create the virtual
# environment that they use.

PYTHON ?= python3
VENV ?= .venv
QGIS_PYTHON ?= /usr/bin/python3
QGIS_VENV ?= .venv-qgis
BIN := $(VENV)/bin
SAMPLE := data_samples/olinda_landsat7_rgb_uint8.tif
SITE := build/docs
KERNEL_TESTS := $(addprefix tests/test_,baselines.py certificate.py contours.py detect.py \
	kernels.py outline.py paint.py rasterize.py refine_kernels.py refine_parts.py refine_remove.py \
	tiled.py topology.py triangulate.py volume.py zonal.py)

.DEFAULT_GOAL := help
.PHONY: help demo test test-fast test-bounds lint hooks docs bench bench-scale bench-fidelity bench-web plugin test-qgis qgis-is-there clean

help:
	@echo "make demo    mesh a real satellite image into out/, with pictures"
	@echo "make test    run everything: pytest, ruff, mypy, import-linter, codespell"
	@echo "make test-fast  pytest without its slow tests: less than two minutes"
	@echo "make test-bounds  the tests of compiled kernels, with every index checked"
	@echo "make lint    ruff, mypy, import-linter and codespell alone"
	@echo "make hooks   check each commit: ruff and codespell, before it is made"
	@echo "make docs    build the documentation into $(SITE)/"
	@echo "make bench   compare speed with the peers, in one run"
	@echo "make bench-scale  time and memory from 1 to 120 megapixels, beside the bare work"
	@echo "make bench-fidelity  how faithfully meshes show images and DEMs, beside other methods"
	@echo "make bench-web  the web map of a million triangles, beside deck.gl and folium"
	@echo "make plugin  pack the QGIS plugin into dist/"
	@echo "make test-qgis  test the plugin with the QGIS of this machine (QGIS_PYTHON=$(QGIS_PYTHON))"
	@echo "make clean   remove $(VENV), $(QGIS_VENV), out/, dist/ and caches"

$(BIN)/.installed: pyproject.toml constraints.txt
	@echo "Building $(VENV) (a minute or two, once) ..."
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "geomesh needs Python 3.11 or newer: make PYTHON=python3.12 ..."; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --upgrade pip
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[figures]'
	@echo "Compiling, once ..."
	@$(BIN)/python -c "import geomesh.pipeline.mesh_scene, geomesh.refine.rmse_plan; \
		import geomesh.refine.bound_plan, geomesh.refine.shift, geomesh.arrays.jit; \
		geomesh.arrays.jit.prepare_kernels(lambda: None)"
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
	$(BIN)/geomesh view out/olinda.gpkg -o out/olinda.html --embed $(SAMPLE) --overwrite
	@echo
	@echo "Made from $(SAMPLE):"
	@echo "  out/olinda.html        a map of the mesh beside the image: open it in a browser"
	@echo "  out/olinda.gpkg        the mesh: layers triangles, edges and nodes, certified"
	@echo "  out/olinda_stages.png  what each stage of the pipeline gives"
	@echo "  out/olinda_mesh.png    the mesh on the map"
	@echo "Next:"
	@echo "  $(BIN)/geomesh quality out/olinda.gpkg       Ki and the standard measures"
	@echo "  $(BIN)/geomesh mesh your.tif -o mesh.gpkg    your own raster"
	@echo "  open out/olinda.gpkg in QGIS, or: geopandas.read_file('out/olinda.gpkg')"

test: $(BIN)/.developing
	$(BIN)/python -m pytest --numprocesses auto --dist loadgroup --cov --cov-report term
	$(MAKE) --no-print-directory lint

test-fast: $(BIN)/.developing
	$(BIN)/python -m pytest --numprocesses auto --dist loadgroup -m "not slow"

# The compiled loops of numba, with a check of every array index. They have their own cache,
# because compiling takes a minute on two cores and no other target needs that code.
test-bounds: $(BIN)/.developing
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR="$(abspath build)/bounds-checked" $(BIN)/python -m pytest \
		--numprocesses auto $(KERNEL_TESTS)

lint: $(BIN)/.developing
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	PYTHONPATH=qgis_plugin $(BIN)/lint-imports --no-logo
	$(BIN)/codespell

hooks: $(BIN)/.developing
	$(BIN)/pre-commit install

$(BIN)/.documenting: $(BIN)/.installed
	@echo "Adding what the documentation needs ..."
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --group docs
	@touch $@

# Build everything again: this removes old pages, and the tutorial must run in any case.
docs: $(BIN)/.documenting
	@rm -rf $(SITE)
	$(BIN)/python -m sphinx --quiet --fail-on-warning --keep-going --nitpicky docs $(SITE)
	@$(BIN)/python docs/check.py $(SITE)
	@echo "The documentation: $(abspath $(SITE))/index.html"

bench: $(BIN)/.developing
	$(BIN)/python -m benchmarks

bench-scale: $(BIN)/.developing
	$(BIN)/python -m benchmarks.scale

bench-fidelity: $(BIN)/.developing
	$(BIN)/python -m benchmarks.fidelity

bench-web: $(BIN)/.developing
	$(BIN)/python -m benchmarks.web_map -o out/web_map

plugin: $(BIN)/.installed
	@$(BIN)/python qgis_plugin/build.py

# Stops at once and says what is missing, because skipped tests would not test the plugin.
qgis-is-there:
	@$(QGIS_PYTHON) -c 'import ensurepip, qgis.core' 2>/dev/null || { \
		echo "$(QGIS_PYTHON) does not see QGIS: apt-get install --no-install-recommends" \
			"qgis python3-qgis qgis-providers python3-venv xvfb xauth"; exit 1; }

$(QGIS_VENV)/.installed: qgis_plugin/requirements-test.txt | qgis-is-there
	@echo "Building $(QGIS_VENV) on the Python of QGIS ..."
	$(QGIS_PYTHON) -m venv --clear --system-site-packages $(QGIS_VENV)
	$(QGIS_VENV)/bin/python -m pip install --quiet --requirement qgis_plugin/requirements-test.txt
	$(QGIS_VENV)/bin/python -m pip install --quiet --no-deps PyQt6==6.8.1  # read, never imported
	@touch $@

# The tests have their own profile and runtime folder. They do not read or change yours.
# The Python inside QGIS takes its library from the first python3 on the PATH.
test-qgis: qgis-is-there $(BIN)/.installed $(QGIS_VENV)/.installed
	@rm -rf qgis_plugin/.qgis-settings
	@runtime=$$(mktemp -d) && trap 'rm -rf "$$runtime"' EXIT && \
	PATH="$(dir $(QGIS_PYTHON)):$$PATH" XDG_RUNTIME_DIR="$$runtime" QT_QPA_PLATFORM=offscreen \
	GEOMESH_PYTHON="$(abspath $(BIN))/python" \
	$(QGIS_VENV)/bin/python -m pytest -c qgis_plugin/pytest.ini qgis_plugin/tests

clean:
	rm -rf $(VENV) $(QGIS_VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	rm -rf qgis_plugin/.pytest_cache qgis_plugin/.qgis-settings
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
