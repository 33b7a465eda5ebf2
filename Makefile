# Everything runs in .venv, which the first target that needs it sets up from pyproject.toml. Compiled sources are kept,
# whatever the environment says: to rewrite the asserts of all tests takes each process some seconds.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PARALLEL := -n logical --dist worksteal
export PYTHONDONTWRITEBYTECODE :=
COMPILED := tests/unit/measurements/test_chebyshev_predictor.py tests/unit/jobs/test_evaluation.py \
	tests/unit/estimation/test_kernels.py tests/unit/noise/test_whiteners.py \
	tests/unit/dynamics/test_gravity.py tests/unit/dynamics/test_terms.py
SMOKE := tests/unit/test_package.py tests/unit/test_cli.py tests/unit/test_readers.py tests/unit/test_bad_input.py \
	tests/unit/io/test_parquet.py \
	tests/unit/kernels tests/unit/lunar/test_terrain_files.py tests/unit/jobs/test_trajectory_study.py \
	tests/unit/jobs/test_monte_carlo.py tests/unit/results tests/unit/report

.PHONY: demo test test-studies test-all fuzz coverage test-uncompiled test-lowest package audit lint docs notebooks bench benchmark calibration faults scaling clean

$(VENV)/.installed-demo: pyproject.toml  # Python compiles the modules that it imports; pip would compile all, for 14 s.
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --no-compile --editable .
	touch $@

$(VENV)/.installed-dev: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	touch $@ $(VENV)/.installed-demo

demo: $(VENV)/.installed-demo  ## Locate the Apollo 15 reflector from real laser ranges.
	$(BIN)/radioloc locate examples/apollo15/apollo15.toml --out out/apollo15

test: $(VENV)/.installed-dev  ## Run the tests that take a moment each.
	$(BIN)/python -m pytest $(PARALLEL) -m "not slow and not study"

test-studies: $(VENV)/.installed-dev  ## Run whole studies, pages and figures, each about a second.
	$(BIN)/python -m pytest $(PARALLEL) -m "study and not slow"

test-all: $(VENV)/.installed-dev  ## Run all tests: also slow ones, what the documentation runs, and long searches for failures.
	$(BIN)/python -m pytest $(PARALLEL) --hypothesis-profile=thorough

SECONDS ?= 7200
SEED ?= 1
fuzz: $(VENV)/.installed-dev  ## Read damaged files for SECONDS (two hours), all or the named TARGETS, and count refusals and failures.
	PYTHONPATH=tests/support $(BIN)/python tests/support/fuzz_readers.py out/fuzz $(SEED) $(SECONDS) $(TARGETS)

coverage: $(VENV)/.installed-dev  ## Lines of the library that no test runs, over all tests, those of compiled code with the compiler off.
	$(BIN)/python -m pytest $(PARALLEL) --cov --cov-report=
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest $(PARALLEL) -m "not slow" --cov --cov-append --cov-report=term --cov-fail-under=95 $(COMPILED)

notebooks: $(VENV)/.installed-dev  ## Run the notebooks, and hold what they show against what their files keep.
	$(BIN)/python -m pytest $(PARALLEL) tests/unit/test_notebooks.py

test-uncompiled: $(VENV)/.installed-dev  ## Run the tests of compiled code with the compiler off, so that they see every line.
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest $(PARALLEL) -m "not slow" $(COMPILED)

test-lowest:  ## Install the lowest versions that pyproject.toml allows, in a venv of their own, and run smoke tests there.
	$(PYTHON) -m venv --clear $(VENV)-lowest
	$(VENV)-lowest/bin/python -m pip install --quiet uv
	$(VENV)-lowest/bin/uv pip install --quiet --python $(VENV)-lowest --resolution lowest-direct --editable ".[dev]"
	$(VENV)-lowest/bin/python -m pytest $(PARALLEL) -W ignore -m "not slow" $(SMOKE)  # of old packages' warnings none is ours

package:  ## Build source distribution and wheel, check them, and run the wheel in an environment that has nothing else.
	$(PYTHON) -m venv --clear $(VENV)-package
	$(VENV)-package/bin/python -m pip install --quiet build twine cffconvert
	rm -rf dist
	$(VENV)-package/bin/python -m build
	$(VENV)-package/bin/twine check --strict dist/*
	$(VENV)-package/bin/cffconvert --validate
	$(PYTHON) -m venv --clear $(VENV)-package
	$(VENV)-package/bin/python -m pip install --quiet dist/*.whl
	$(VENV)-package/bin/radioloc doctor
	$(VENV)-package/bin/radioloc locate examples/apollo15/apollo15.toml

audit: $(VENV)/.installed-dev  ## Look for known vulnerabilities in what the package and its development need.
	$(BIN)/python -m pip install --quiet pip-audit
	$(BIN)/pip-audit --skip-editable

lint: $(VENV)/.installed-dev  ## Style, types and the direction of imports.
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

$(VENV)/.installed-bench: $(VENV)/.installed-dev
	$(BIN)/python -m pip install --quiet --editable ".[bench]"
	touch $@

docs: $(VENV)/.installed-dev  ## The documentation as a site, out/docs/index.html.
	rm -rf docs/reference/python  # made anew, without what is no more
	$(BIN)/python -m sphinx -E -W --keep-going -q -b html -c docs -d out/doctrees . out/docs

bench: $(VENV)/.installed-bench  ## Times, goals and ratios to other programs in one table; BENCH_ARGS are groups.
	PYTHONPATH=tests/support OMP_NUM_THREADS=1 $(BIN)/python tests/benchmarks/bench.py $(BENCH_ARGS)

benchmark: $(VENV)/.installed-demo  ## Run and score all cases of examples/benchmark: tables in out/benchmark.
	$(BIN)/radioloc score examples/benchmark --out out/benchmark

DRAWS ?= 300
calibration: $(VENV)/.installed-dev  ## Draw known truths in all kinds of tracking, and hold stated sigmas against their errors: table and figure in out/calibration.
	PYTHONPATH=tests/support $(BIN)/python tests/support/calibration.py --draws $(DRAWS) $(if $(CELL),--cell "$(CELL)")

faults: $(VENV)/.installed-dev  ## Fit simulated tracking with faults; FAULTS_ARGS are worlds, faults and seeds (--help).
	PYTHONPATH=tests/support OMP_NUM_THREADS=1 $(BIN)/python tests/benchmarks/faults.py $(FAULTS_ARGS)

scaling: $(VENV)/.installed-dev  ## Time and memory from a thousand to ten million observations, as docs/images/scaling.png.
	$(BIN)/python tests/benchmarks/scaling.py docs/images/scaling.png

clean:
	rm -rf docs/reference/python $(VENV) $(VENV)-lowest $(VENV)-package dist out .pytest_cache .mypy_cache .ruff_cache .hypothesis
