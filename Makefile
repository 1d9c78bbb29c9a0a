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

STUDY_PHASE = $(BIN)/posterior study phase-retrieval --data "$(POSTERIOR_DATA)/prdeep_natural6.npz"

# With the study data, also what the tables compare with: every table of the README that they make.
# Days of two cores; each goes on where it was stopped, and may be run by itself.
study: .venv/installed-test $(if $(POSTERIOR_DATA),out/celeba)
ifdef POSTERIOR_DATA
	$(BIN)/python -m pip install --quiet --constraint $(CONSTRAINTS) --editable '.[baselines]'
endif
	$(BIN)/python -m pytest -m slow --durations=0 -s
ifndef POSTERIOR_DATA
	$(BIN)/posterior study approximations --out out/approximations
else
	$(BIN)/posterior study approximations --data "$(POSTERIOR_DATA)/dsb2018_nuclei" --out out/approximations
	$(BIN)/posterior study denoising --data "$(POSTERIOR_DATA)/dsb2018_nuclei" --out out/study
	$(BIN)/posterior study denoising --data out/celeba --prior faces --pictures 16 --draws 8 --out out/faces
	$(BIN)/posterior study measured --data "$(POSTERIOR_DATA)/fmd" --out out/measured
	$(BIN)/posterior study measured --data "$(POSTERIOR_DATA)/fmd" --simulated --out out/measured-simulated
	$(STUDY_PHASE) --definition prdeep --seeds 3 --out out/phase
	$(STUDY_PHASE) --definition poisson --out out/phase-poisson
	$(STUDY_PHASE) --definition poisson-8 --system HIO --out out/phase-poisson-8
	$(STUDY_PHASE) --definition prdeep --prior natural-large --system "annealed from ADMM" --out out/phase-large
	$(STUDY_PHASE) --definition prdeep --alpha 4 --pictures 2 --draws 50 --system "annealed from ADMM" --out out/phase-variance
	$(BIN)/posterior study ptychography --data "$(POSTERIOR_DATA)/fpm" --out out/ptychography
	$(BIN)/posterior study ptychography --stack "$(POSTERIOR_DATA)/fpm/bloodsmear_red.npz" --out out/stack-red
	$(BIN)/posterior study ptychography --stack "$(POSTERIOR_DATA)/fpm/bloodsmear_green.npz" --out out/stack-green
endif

out/celeba: $(wildcard $(POSTERIOR_DATA)/celeba_*.zip)
	$(BIN)/python -m zipfile --extract $< $@.part && mv $@.part $@

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
