# Bare Python 3.11 and make are enough: everything is installed into .venv. `make demo` first.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/pip --disable-pip-version-check --quiet
PINNED := pyproject.toml constraints.txt
BRIDGE := services/ros_bridge
MESSAGES ?= b

REQUIREMENTS := deploy/requirements

# With this set, each of the many test processes would compile all of zarm's Python files again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test test-rest test-all test-deploy ros lint docs bench requirements licences audit clean

demo: $(VENV)/.kernels
	@$(BIN)/zarm demo

# Runs tests. A busy machine that freezes for a second makes tests fail, so failed tests run again, one at a time, and must pass
# then or the next time. All runs are printed.
PYTEST = $(BIN)/pytest --ignore=tests/deploy
define run_tests
@$(PYTEST) --cache-clear $(1) $(2) || { [ $$? = 1 ] || exit 1; for time in once twice; do \
	echo "== what failed, $$time more"; $(PYTEST) $(1) $(if $(2),--numprocesses=1) --last-failed && exit 0; done; exit 1; }
endef

# Each part once, in minutes. Tests mostly wait for robots, so two cores can run four at a time, and timed tests two. Without the ROS
# bridge its tests are skipped, and say so.
test: $(VENV)/.dev $(VENV)/.kernels
	@$(MAKE) --no-print-directory ros || true
	$(call run_tests,-m "fast or essential",--numprocesses=4)

# Every other promise once: CI runs both.
test-rest: $(VENV)/.dev $(VENV)/.kernels
	@$(MAKE) --no-print-directory ros || true
	$(call run_tests,-m "not (fast or essential or slow or timed)",--numprocesses=4)
	$(call run_tests,-m "timed and not slow",--numprocesses=2)

# Every test, also the slow ones that these skip, with more examples of each property.
test-all: $(VENV)/.dev $(VENV)/.kernels
	@$(MAKE) --no-print-directory ros || true
	$(call run_tests,--hypothesis-profile=full -m "not timed",--numprocesses=4)
	$(call run_tests,--hypothesis-profile=full -m timed,--numprocesses=2)

# Builds the images of deploy/ and tests them on a Docker engine. The first time takes minutes, mostly to compile.
COMPOSE = $(if $(shell docker compose version 2>/dev/null),docker compose,docker-compose)

test-deploy: export ZARM_TAG = test
test-deploy: $(VENV)/.dev
	@bash -c 'time $(COMPOSE) --project-directory deploy -f deploy/compose.yaml --profile sim --profile perception build'
	@docker image ls --filter reference='zarm-*:test'
	@$(BIN)/pytest tests/deploy

# Installs ROS 2 and builds one generation of the bridge's messages, `make ros MESSAGES=a`; earlier builds come from a cache.
ros: $(VENV)/.ros_packages | $(VENV)/.planner
	@$(BIN)/python $(BRIDGE)/build_messages.py $(MESSAGES)

lint: $(VENV)/.dev
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/deptry .

# Generates the reference from the code, then builds the site in site/, without network; a broken link is an error.
docs: $(VENV)/.dev
	@$(BIN)/python docs/generate.py
	@$(BIN)/zensical build --clean --strict

bench: $(VENV)/.dev $(VENV)/.kernels
	@for file in tests/benchmarks/*.py; do echo "== $$file"; $(BIN)/python $$file || exit 1; done

# Writes what each image of deploy/ installs, in the versions of constraints.txt, with the hashes of all files. empy only generates
# messages, so the image of the bridge does without it.
COMPILE := $(BIN)/uv pip compile --quiet --no-config --python-version 3.11 --python-platform x86_64-manylinux_2_36 \
	--only-binary :all: --no-binary empy --generate-hashes --annotation-style line \
	--custom-compile-command "make requirements" --constraints constraints.txt

requirements: $(VENV)/.dev
	@rm -f $(REQUIREMENTS)/*.txt
	$(COMPILE) --group wheel -o $(REQUIREMENTS)/wheel.txt
	$(COMPILE) pyproject.toml --extra metrics -o $(REQUIREMENTS)/executor.txt
	$(COMPILE) pyproject.toml --extra metrics --extra planner -o $(REQUIREMENTS)/planner.txt
	$(COMPILE) pyproject.toml --extra metrics --extra viewer -o $(REQUIREMENTS)/viewer.txt
	$(COMPILE) pyproject.toml --extra metrics --extra ros --no-emit-package empy -o $(REQUIREMENTS)/ros_bridge.txt
	$(COMPILE) pyproject.toml --extra ros --extra ros-messages -o $(REQUIREMENTS)/ros_build.txt

licences: $(VENV)/.dev $(VENV)/.ros_packages
	$(BIN)/uv tool run --quiet pip-licenses@5.5.5 --python $(BIN)/python --with-system --format json > $(VENV)/licences.json
	$(BIN)/python deploy/licences.py < $(VENV)/licences.json > deploy/LICENCES.md

# Asks PyPI for known vulnerabilities; a package that it cannot check is a failure too.
audit: $(VENV)/.dev
	@for file in $(REQUIREMENTS)/*.txt; do echo "== $$file"; \
		$(BIN)/uv tool run --quiet pip-audit@2.10.1 --strict --disable-pip --require-hashes --progress-spinner off -r $$file || exit 1; done

clean:
	rm -rf $(VENV) site .cache .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis
	find libs services tests -name __pycache__ -type d -prune -exec rm -rf {} +

# One stamp for the packages that run zarm, one for those that develop it; the second includes the first. Python compiles what it imports, later.
$(VENV)/.planner: $(PINNED) | $(BIN)/python
	@echo "installing zarm into $(VENV) ..."
	@$(PIP) install --no-compile -c constraints.txt -e ".[planner,import,viewer,sim]"
	@touch $@

$(VENV)/.dev: $(PINNED) | $(BIN)/python
	@echo "installing zarm and its tools into $(VENV) ..."
	@$(PIP) install --no-compile -c constraints.txt -e ".[planner,dev]"
	@$(PIP) install --no-compile --no-deps lerobot==0.4.4 -e libs/lerobot_robot_zarm # without what it trains with
	@touch $@ $(VENV)/.planner

$(VENV)/.ros_packages: $(PINNED) | $(BIN)/python
	@echo "installing ROS 2 into $(VENV) ..."
	@$(PIP) install --no-compile -c constraints.txt -e ".[ros,ros-messages]" || { echo "The ROS bridge is left out: pip finds no packages of ROS 2 \
	for this machine and Python; all else works without, and where ROS 2 Jazzy is installed colcon builds the messages."; exit 1; }
	@touch $@

# Compiles the kernels of planner, servo and perception once; later runs load them from the cache.
$(VENV)/.kernels: $(patsubst %,$(VENV)/.kernels_%,planner servo perception)
	@touch $@

$(VENV)/.kernels_%: $(VENV)/.planner $(wildcard libs/*/*/kernels/*.py services/*/*/kernels/*.py)
	@echo "compiling the kernels of the $*, once ..."
	@$(BIN)/python -m zarm_$*.warm_up
	@touch $@

$(BIN)/python:
	@$(PYTHON) -m venv $(VENV)
