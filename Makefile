# make train and make test do everything on a machine that has only Python and make.
# A CPU-only torch, far smaller than PyPI's: make train TORCH_INDEX=https://download.pytorch.org/whl/cpu

VENV := .venv
PYTHON := $(VENV)/bin/python
STAMP := $(VENV)/.installed
CONSTRAINTS := constraints.txt
PIP := $(PYTHON) -m pip install --quiet --disable-pip-version-check $(CONSTRAINTS:%=-c %)
TORCH_INDEX ?=
TORCH := torch
EXTRAS := progress,tensorboard,contrib,film,plots,notebook,track,mlflow,hub,dataset,sweep,benchmarks,tests,docs,dev
ARGS ?=

NEWEST := .venv-newest
LEROBOT := .venv-lerobot
PYTHONS := python3.11 python3.12 python3.13 python3.10 python3 python
VERSIONS := 3.10 3.11 3.12 3.13

.PHONY: help venv enjoy train test test-slow test-zoo test-newest test-lerobot test-pythons audit lint docs benchmark clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(MAKEFILE_LIST) | expand -t 14

venv: $(STAMP) ## create .venv and install everything

enjoy: $(STAMP) ## film the agent that ships with the package (ARGS="--env WamStereoReach-v0")
	$(PYTHON) enjoy.py --pretrained --video film.mp4 --n-episodes 3 $(ARGS)

train: $(STAMP) ## train our DDPG agent and evaluate it (ARGS="--algo dqn --seed 1")
	$(PYTHON) train.py $(ARGS)

test: $(STAMP) ## run the tests (ARGS="-k config")
	$(PYTHON) -m pytest -q -n 2 --dist loadfile -m "not slow and not zoo" $(ARGS)

test-slow: $(STAMP) ## run the slow tests
	$(PYTHON) -m pytest -q -m "slow and not zoo" $(ARGS)

test-zoo: $(STAMP) ## install rl_zoo3 and train with it
	$(PIP) -e ".[zoo]"
	$(PYTHON) -m pytest -q -m zoo $(ARGS)

test-newest: ## run the tests with the newest versions that setup.cfg allows, in a fresh .venv-newest
	rm -rf $(NEWEST)
	$(MAKE) --no-print-directory VENV=$(NEWEST) CONSTRAINTS= test

# Its torch is older than the pinned one; installed first, no second one is downloaded.
test-lerobot: ## run the tests of datasets and environments for LeRobot, in a .venv-lerobot with Python 3.12 or newer
	$(MAKE) --no-print-directory VENV=$(LEROBOT) PYTHONS="python3.12 python3.13" CONSTRAINTS= TORCH="torch<2.12" \
		EXTRAS=lerobot,progress,tests ARGS="tests/sharing/test_lerobot.py $(ARGS)" test

test-pythons: ## run the tests on Python 3.10 to 3.13, each in a .venv-VERSION (VERSIONS="3.12")
	@for version in $(VERSIONS); do \
		$(MAKE) --no-print-directory VENV=.venv-$$version PYTHONS=python$$version test || exit 2; \
	done

audit: $(STAMP) ## check the pinned versions for known vulnerabilities (needs the network)
	$(PIP) -e ".[audit]"
	$(PYTHON) -m pip_audit --strict -r constraints.txt --no-deps --disable-pip $(ARGS)

lint: $(STAMP) ## check style and types
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .
	$(PYTHON) -m mypy

docs: $(STAMP) ## build the documentation into site/
	NO_MKDOCS_2_WARNING=1 $(PYTHON) -m mkdocs build --strict

benchmark: $(STAMP) ## train the missing cells of the paper's tables and write benchmarks/RESULTS.md (hours)
	$(PYTHON) -m benchmarks.tables.paper $(ARGS)

clean: ## remove builds and caches; keeps .venv and logs
	rm -rf build dist site *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage htmlcov
	find . -name __pycache__ -not -path "./$(VENV)/*" -prune -exec rm -rf {} +

# Torch comes first and pinned: as a mere dependency, pip would pick whatever build is the newest. NumPy comes before
# PyBullet, which is built with it where there is no wheel.
$(STAMP): setup.cfg pyproject.toml constraints.txt | $(PYTHON)
	$(PIP) $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX)) "$(TORCH)"
	$(PIP) setuptools wheel numpy
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info >= (3, 12))' || { \
		echo "PyBullet has no wheel for $$($(PYTHON) --version): building it takes about four minutes and a C++ compiler."; \
		command -v c++ >/dev/null || { echo "There is no C++ compiler (c++) on the PATH; install one, e.g. g++." >&2; exit 2; }; \
	}
	$(PIP) --no-build-isolation -e ".[$(EXTRAS)]"
	@touch $@

$(PYTHON):
	@for python in $(PYTHONS); do \
		if $$python -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' >/dev/null 2>&1; then \
			echo "Creating $(VENV) with $$($$python --version)"; exec $$python -m venv $(VENV); \
		fi; \
	done; \
	echo "sb3_stereo needs Python 3.10 to 3.13, and there is no $(PYTHONS) of these on the PATH." >&2; \
	exit 2
