# Everything a fresh machine needs: git, make and Python 3.11 or newer. `make help` lists the targets.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Most tests keep one core busy: compiling, and bodies too small for threads. Three on two cores, because some wait for what another compiles.
# `make test WORKERS=` runs them one after the other.
WORKERS ?= -n 3 --dist worksteal
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: examples bench-sweep bench-robots release test-minimum optunahub bench-least-squares measured pytest lint-benchmarks bench-workers test-workers faults fuzz bench-fit bench-startup docs test-docs test-wheel tour bench-advice help setup design test test-long test-gp lint bench bench-accuracy claims bench-sampler bench-design bench-bounds bench-robust validate stability schema gallery clean bench-convergence test-browser bench-view
help:
	@echo "make design     set up, and run data/studies/s_shape.yaml to its best design, with pictures (runs/s_shape)"
	@echo "make test       set up, and run linters and tests"
	@echo "make test-long  the longer validation cases as well"
	@echo "make test-gp    the tests of studies by gp and by Optuna's GPSampler, in an environment of their own with torch (some 200 MB)"
	@echo "make test-workers  several workers on PostgreSQL (apt-get install postgresql) and Optuna's gRPC proxy, killed now and then"
	@echo "make bench-sweep  equilibria by two processes, over one after another (RUNS=200)"
	@echo "make bench-workers  trials a second with one and with two workers (TRIALS=30)"
	@echo "make faults     500 SIGKILLs, full disks, a clock set back, ...: what completed trials are lost (QUICK=1, KILLS=N)"
	@echo "make test-browser  the pages of magmpm view and dashboard in Chromium (apt-get install chromium)"
	@echo "make bench      measure; prints a table and writes runs/bench/bench.json (QUICK=1, FIGURES=effect_cost_percent)"
	@echo "make bench-sampler  trials to 2 mm of tpe, gp and gauss-newton, with and without the rod's designs"
	@echo "make bench-design   solves and seconds of the samplers to 2, 0.5 and 0.1 mm on 24 targets (QUICK=1)"
	@echo "make bench-bounds  whether a stronger field ever gives a worse design: 40 drawn targets, three seeds, five bounds (BODIES=4)"
	@echo "make bench-accuracy  true error over promised error of 100 scenes drawn at random"
	@echo "make bench-convergence  how the error falls with the cells on 100 bodies drawn at random"
	@echo "make bench-robots  robots of parts drawn at random: Newton steps, seconds, and whether a slow load leads to the same shape (ROBOTS=40, QUICK=1)"
	@echo "make bench-fit  how often the intervals of magmpm fit hold the truth, over 1 000 synthetic fits (QUICK=1: 100; POSES=poses: a magnet in each row)"
	@echo "make measured   public measurements, fitted and predicted: pictures and tables of docs/measured.md (CASES=kim)"
	@echo "make bench-least-squares  the Gauss-Newton sampler against Optuna's on five public problems: the table of docs/optunahub/problems.md (SEEDS=5, SAMPLERS=tpe)"
	@echo "make optunahub  that sampler as a package in the layout of OptunaHub, in runs/optunahub; its tests run there"
	@echo "make release    wheel, sdist, site and the sampler's package, in runs/release; the wheel is tried in an empty environment"
	@echo "make test-minimum  the tests with the least versions of libraries that setup.cfg allows, in .venv-minimum"
	@echo "make bench-startup  seconds until each command could begin its work"
	@echo "make fuzz       10 000 hostile inputs: scenes, studies, meshes, tables (INPUTS=N, SEED=S)"
	@echo "make bench-view  milliseconds from a slider to the new shape in Chromium"
	@echo "make claims     every measured figure of README and docs made again; says what differs (QUICK=1, WRITE=1)"
	@echo "make validate   statics against every finite-element reference, over the cell size"
	@echo "make gallery    run and draw every scene of data/scenes/gallery; pages in docs/gallery, movies in runs/gallery"
	@echo "make examples   every script of examples/; their pictures in docs/images/examples (EXAMPLES=first_shape)"
	@echo "make docs       the pages as a site, in runs/site; broken links fail"
	@echo "make test-docs  every page's code, followed in order, and the notebook"
	@echo "make test-wheel the wheel, installed and used in an empty environment (PYTHON=python3.13)"
	@echo "make tour       every page followed word for word in a clean environment, with the wheel alone (PAGES=first_scene.md)"
	@echo "make stability  the hard cases, each with its measure and bound; CONTROLS=1: each with its remedy off; RANDOM=300 SEED=1: random scenes"
	@echo "make targets-short  every target of this file in its shortest form: what fails, and what needs a program that is not here"
	@echo "make clean      remove the virtual environment and caches"

# A virtual environment of its own. Debian ships venv apart from python3; virtualenv does as well.
$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "magmpm needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) -V 2>&1). Try: make PYTHON=python3.12"; exit 1; }
	@$(PYTHON) -m venv $(VENV) 2>/dev/null || $(PYTHON) -m virtualenv -q $(VENV) || \
	  { rm -rf $(VENV); echo "no virtual environment can be made here; install one with: apt-get install python3-venv"; exit 1; }

setup: $(VENV)/.ready
$(VENV)/.ready: setup.cfg pyproject.toml constraints.txt | $(BIN)/python
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[all]'
	@touch $@

$(VENV)/.ready-test: $(VENV)/.ready
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[all,test]'
	@touch $@

design: $(VENV)/.ready
	$(BIN)/magmpm design data/studies/s_shape.yaml

lint: $(VENV)/.ready-test
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Linters beside the tests, which do not keep all cores busy throughout. Both end before make does, and either one's failure is make's.
test: $(VENV)/.ready-test
	$(MAKE) --no-print-directory -j2 lint pytest

pytest: $(VENV)/.ready-test
	$(BIN)/python -m pytest -m "not slow" $(WORKERS)

# Names and calls of benchmarks, which no test runs.
lint-benchmarks: $(VENV)/.ready-test
	MYPYPATH=tests:tests/benchmarks $(BIN)/mypy --explicit-package-bases --allow-untyped-defs \
	  --disable-error-code union-attr --disable-error-code var-annotated --disable-error-code arg-type tests/benchmarks

test-long: lint lint-benchmarks
	$(BIN)/python -m pytest $(WORKERS)

# Studies by Optuna's GPSampler need torch, which no other test does: a second environment, with PyTorch's own wheels for CPUs (those of PyPI bring CUDA,
# several GB), or PyPI's where that index can't be reached.
GP_VENV ?= .venv-gp
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
$(GP_VENV)/.ready: setup.cfg pyproject.toml constraints.txt
	@test -x $(GP_VENV)/bin/python || $(PYTHON) -m venv $(GP_VENV) 2>/dev/null || $(PYTHON) -m virtualenv -q $(GP_VENV)
	-$(GP_VENV)/bin/python -m pip install -q --no-deps --retries 1 --timeout 30 torch --index-url $(TORCH_INDEX)
	$(GP_VENV)/bin/python -m pip install -q -c constraints.txt -e '.[gp,test]'
	@touch $@

test-gp: $(GP_VENV)/.ready
	$(GP_VENV)/bin/python -c "import torch; print('torch', torch.__version__)"
	$(GP_VENV)/bin/python -m pytest tests/studies -k "gp or GP" -rs

# Several workers need a database server, which the tests start themselves on the loopback.
$(VENV)/.ready-workers: $(VENV)/.ready-test
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[postgresql,grpc,s3,test]' 'moto[server]' distributed
	@touch $@

test-workers: $(VENV)/.ready-workers
	@command -v initdb >/dev/null || ls /usr/lib/postgresql/*/bin/initdb >/dev/null 2>&1 || echo "no PostgreSQL here: apt-get install postgresql"
	$(BIN)/python -m pytest tests/workers -rs

bench-sweep: $(VENV)/.ready-test
	PYTHONPATH=. $(BIN)/python tests/benchmarks/sweep.py $(or $(RUNS),200)

bench-workers: $(VENV)/.ready-test
	PYTHONPATH=. $(BIN)/python tests/benchmarks/workers.py

faults: $(VENV)/.ready-workers
	$(BIN)/python tests/faults/faults.py --kills $(or $(KILLS),$(if $(QUICK),20,500))
# Chromium comes from the system; Playwright, which drives it, from PyPI.
test-browser: $(VENV)/.ready-test
	@command -v chromium || command -v chromium-browser || command -v google-chrome || \
	  { echo "tests in the browser need Chromium; install it with: apt-get install chromium"; exit 1; }
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[browser]'
	$(BIN)/python -m pytest tests/browser -rs

# From a slider to the new shape on the screen, measured in the browser.
bench-view: $(VENV)/.ready-test
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[browser]'
	PYTHONPATH=. $(BIN)/python tests/benchmarks/view_latency.py

bench-sampler: $(VENV)/.ready-test
	$(BIN)/python tests/benchmarks/sampler.py $(or $(SAMPLER),tpe) $(SEEDS)
	$(if $(SAMPLER),,$(BIN)/python tests/benchmarks/sampler.py tpe+rod)
	$(if $(SAMPLER),,$(BIN)/python tests/benchmarks/sampler.py gp)
	$(if $(SAMPLER),,$(BIN)/python tests/benchmarks/sampler.py gp+rod)

bench-insertion: $(VENV)/.ready-test
	PYTHONPATH=. $(BIN)/python tests/benchmarks/insertion_paths.py runs/bench-insertion $(if $(QUICK),--rods) $(if $(EACH),--each $(EACH))

bench-advice: $(VENV)/.ready-test
	PYTHONPATH=. $(BIN)/python tests/benchmarks/advice.py $(SCENES)

bench-convergence: $(VENV)/.ready-test
	$(BIN)/python tests/benchmarks/drawn_convergence.py $(if $(SCENES),--scenes $(SCENES))

bench-accuracy: $(VENV)/.ready-test
	$(BIN)/python tests/benchmarks/promised_error.py $(if $(SCENES),--scenes $(SCENES))

bench-robots: $(VENV)/.ready-test
	$(BIN)/python tests/benchmarks/drawn_robots.py $(if $(ROBOTS),--robots $(ROBOTS)) $(if $(QUICK),--quick)

bench-robust: $(VENV)/.ready-test
	$(BIN)/python tests/benchmarks/robust.py $(SAMPLES)

bench-bounds: $(VENV)/.ready-test
	$(BIN)/python tests/benchmarks/larger_bounds.py $(if $(TARGETS),--targets $(TARGETS)) $(if $(BODIES),--bodies $(BODIES))

bench-design: $(VENV)/.ready-test
	$(BIN)/python tests/benchmarks/design.py $(if $(QUICK),--quick) $(SAMPLERS)

bench: $(VENV)/.ready-test
	$(BIN)/python tests/benchmarks/bench.py $(if $(QUICK),--quick) $(FIGURES)

claims: $(VENV)/.ready-test
	$(BIN)/python tests/benchmarks/claims.py $(if $(QUICK),--quick) $(if $(WRITE),--write) $(CLAIMS)

validate: $(VENV)/.ready-test
	$(BIN)/python tests/benchmarks/validate.py

stability: $(VENV)/.ready$(if $(CONTROLS)$(RANDOM),-test)
	$(if $(CONTROLS),$(BIN)/python -m pytest -v tests/stability/test_controls.py,$(if $(RANDOM),PYTHONPATH=tests $(BIN)/python -m random_scenes $(RANDOM) --seed $(or $(SEED),0),$(BIN)/magmpm stability $(if $(QUICK),--quick)))

$(VENV)/.ready-docs: $(VENV)/.ready
	$(BIN)/python -m pip install -q -c constraints.txt -e '.[docs,notebook,test]'
	@touch $@

docs: $(VENV)/.ready-docs
	$(BIN)/mkdocs build --strict --quiet
	@echo "runs/site/index.html"

test-docs: $(VENV)/.ready-docs
	$(BIN)/python -m pytest tests/docs $(WORKERS)

test-wheel: $(VENV)/.ready-test
	$(BIN)/python -m pytest tests/end_to_end/test_wheel.py -rs

tour: $(VENV)/.ready-test
	$(BIN)/python tests/docs/tour.py $(PAGES)

schema: $(VENV)/.ready
	$(BIN)/python -c "from magmpm.inputs.settings import write_json_schema as write; from magmpm.scene import Scene; write(Scene, 'magmpm/scene.schema.json')"
	$(BIN)/python -m magmpm.studies.problem.study_file
	$(BIN)/python -m magmpm.studies.goals.goal_file

gallery: $(VENV)/.ready
	$(BIN)/python docs/gallery/build.py $(SCENES)
	$(if $(SCENES),,$(BIN)/python docs/gallery/accuracy.py)
	$(if $(SCENES),,$(BIN)/python docs/gallery/goals.py)

# The pictures of docs/examples.md. Scripts write into the folder where they run.
examples: $(VENV)/.ready-test
	@$(BIN)/python -m pip install -q -c constraints.txt distributed
	@mkdir -p runs/examples docs/images/examples
	@cd runs/examples && for name in $(or $(EXAMPLES),$(basename $(notdir $(wildcard examples/*.py)))); do \
	  echo "$$name" && $(CURDIR)/$(BIN)/python $(CURDIR)/examples/$$name.py && \
	  cp $$name.png $(CURDIR)/docs/images/examples/ || exit 1; done

clean:
	rm -rf $(VENV) $(GP_VENV) $(MINIMUM_VENV) .mypy_cache .ruff_cache .hypothesis *.egg-info

bench-fit: $(VENV)/.ready-test
	$(BIN)/python tests/benchmarks/fit_coverage.py $(if $(QUICK),100,$(or $(FITS),1000)) 0 $(POSES)

measured: $(VENV)/.ready-test
	$(BIN)/python docs/gallery/measured.py $(CASES)

bench-least-squares: $(VENV)/.ready-test
	$(BIN)/python docs/optunahub/compare.py $(or $(SEEDS),5) $(SAMPLERS)

optunahub: $(VENV)/.ready-test
	$(BIN)/python docs/optunahub/build.py

# What a release has: wheel, sdist, site, the sampler's package. The wheel is tried in an empty environment. Nothing is uploaded.
release: docs optunahub
	@rm -rf runs/release && mkdir -p runs/release
	$(BIN)/python -m pip install -q -c constraints.txt build
	$(BIN)/python docs/site/release.py runs/release
	@cp -r runs/site runs/optunahub runs/release/
	WHEEL=$$(ls $(CURDIR)/runs/release/*.whl) $(BIN)/python -m pytest tests/end_to_end/test_wheel.py -rs
	@ls -d runs/release/*

# The least versions that setup.cfg allows, in an environment of their own.
MINIMUM_VENV ?= .venv-minimum
test-minimum:
	@test -x $(MINIMUM_VENV)/bin/python || $(PYTHON) -m venv $(MINIMUM_VENV)
	$(MINIMUM_VENV)/bin/python -m pip install -q -c constraints-minimum.txt -e '.[all,test]'
	$(MINIMUM_VENV)/bin/python -m pytest -m "not slow" $(WORKERS) tests/unit tests/studies tests/end_to_end

bench-startup: $(VENV)/.ready-test
	$(BIN)/python tests/benchmarks/startup.py

# Each target in its shortest form; those that need what is not here (chromium, postgresql, torch) say so.
targets-short: $(VENV)/.ready-test
	$(BIN)/python tests/targets_short.py $(TARGETS)

# Whatever a file holds: a sound value, or an error that says what to do. SEED=S draws other inputs.
INPUTS ?= 10000
fuzz: $(VENV)/.ready-test
	INPUTS=$(INPUTS) $(BIN)/python -m pytest -q -s --tb=short tests/fuzz

.PHONY: fuzz-coverage bench-insertion targets-short
# Guided by coverage; atheris has wheels for Linux alone, so it is no part of the test extra.
fuzz-coverage: $(VENV)/.ready-test
	@$(BIN)/python -c "import atheris" 2>/dev/null || $(BIN)/python -m pip install -q "atheris>=2.3"
	@mkdir -p runs/fuzz
	@for kind in stl axis map schedule measured; do \
	  PYTHONPATH=. $(BIN)/python tests/fuzz/guided.py $$kind -runs=$(or $(RUNS),20000) -timeout=20 > runs/fuzz/$$kind.log 2>&1 \
	    || { tail -40 runs/fuzz/$$kind.log; exit 1; }; \
	  grep -o "cov: [0-9]*" runs/fuzz/$$kind.log | tail -1; echo "$$kind: $$(tail -1 runs/fuzz/$$kind.log)"; done
