# make demo: install and run the main job on a real picture.  make test: install and run all tests.
PYTHON ?= python3
BIN := .venv/bin
# The tested versions; for others install by `pip install .` and leave the file out.
CONSTRAINTS := constraints.txt

.PHONY: demo test study lint bench clean

demo: .venv/installed
	$(BIN)/posterior demo --out out/demo

# Tests compile much and run little: lighter passes of the compiler make them much shorter.
XLA_LIGHT := --xla_backend_optimization_level=1 --xla_cpu_use_fusion_emitters=false

test: .venv/installed-test
	XLA_FLAGS="$(XLA_LIGHT)" $(BIN)/python -m pytest -n 2 --dist worksteal -m "not slow"

# With the study data, also what the tables compare with.
study: .venv/installed-test
ifdef POSTERIOR_DATA
	$(BIN)/python -m pip install --quiet --constraint $(CONSTRAINTS) --editable '.[baselines]'
endif
	$(BIN)/python -m pytest -m slow --durations=0 -s
	$(BIN)/posterior study approximations --out out/approximations
ifdef POSTERIOR_DATA
	$(BIN)/posterior study denoising --data "$(POSTERIOR_DATA)/dsb2018_nuclei" --out out/study
	$(BIN)/posterior study measured --data "$(POSTERIOR_DATA)/fmd" --out out/measured
	$(BIN)/posterior study phase-retrieval --data "$(POSTERIOR_DATA)/prdeep_natural6.npz" --out out/phase-retrieval
	$(BIN)/posterior study ptychography --data "$(POSTERIOR_DATA)/fpm" --out out/ptychography
endif

bench: .venv/installed-test
	$(BIN)/python tests/benchmarks/run.py

lint: .venv/installed-test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

.venv/installed: pyproject.toml $(CONSTRAINTS)
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --constraint $(CONSTRAINTS) --editable .
	touch $@

.venv/installed-test: .venv/installed
	$(BIN)/python -m pip install --quiet --constraint $(CONSTRAINTS) --editable '.[test]'
	touch $@

clean:
	rm -rf .venv out build *.egg-info
