# The two commands that matter: `make repro` (the whole study) and `make test`.
# Both create the environment (.venv) first; both can be repeated at will.

PYTHON ?= python3.11
VENV := .venv
BIN := $(CURDIR)/$(VENV)/bin
export PATH := $(BIN):$(PATH)
export PYTHONUNBUFFERED := 1
# BLAS threads beside busy processes on few cores cost more than they bring; stages use worker processes instead.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MLFLOW_DISABLE_TELEMETRY := true

.PHONY: dag help pages deps venv repro tables test tests lint style types params ui lock bench bench-peers check

help:
	@echo "make repro   set up .venv, run the whole study (dvc repro in two lanes), print the tables and the report's path"
	@echo "make test    set up .venv, lint, type-check, run the tests"
	@echo "make check   lint, types and the fast tests: before every commit"
	@echo "make ui      MLflow's comparison of all methods, on http://127.0.0.1:5000"
	@echo "make params  compose conf/ into params.yaml (after editing conf/)"
	@echo "make deps    write into dvc.yaml what each stage imports (after an import or a method has changed)"
	@echo "make pages   write what docs/ quotes of the code (after a new effect, or another message)"
	@echo "make bench   ours and the peers side by side, into reports/benchmarks.csv (QUICK=1: three minutes)"

venv: $(VENV)/.ready

$(VENV)/.ready: requirements.lock pyproject.toml
	@$(PYTHON) --version | grep -q '^Python 3\.11\.' || { echo "error: $(PYTHON) is not Python 3.11; set PYTHON=/path/to/python3.11" >&2; exit 1; }
	@echo "== creating the environment in $(VENV) (about two minutes the first time)"
	@test -x $(VENV)/bin/python || $(PYTHON) -m venv $(VENV)
	@# The lock is complete (pip freeze), so nothing is resolved. Byte code is compiled on two cores, not pip's
	@# one, and here: where PYTHONDONTWRITEBYTECODE is set it would be compiled anew in each of some hundred processes.
	@$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-compile -r requirements.lock
	@$(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@$(VENV)/bin/python -m compileall -q -j 2 -x '/tests/|py312' $(VENV)/lib || echo "note: byte code is incomplete; imports are slower"
	@touch $@

# dvc.lock says what this machine has computed, from data that is not everywhere: it is committed empty (docs/architecture.md)
# and kept out of git's sight. Elsewhere than in a git clone there is nothing to hide.
repro: venv
	@git update-index --skip-worktree dvc.lock 2>/dev/null || true
	@echo "== the whole study, two data sets at a time (stages that are up to date are skipped); as dvc repro, but faster"
	@python -m stages.lanes $(ARGS)
	@$(MAKE) --no-print-directory tables

tables: venv
	@python -m stages.print_tables

lint: style types

style: venv
	@echo "== style"
	@ruff check .
	@ruff format --check .

types: venv
	@echo "== types"
	@mypy

# Before every commit: what needs no pass through the pipeline.
check: lint
	@pytest -n 2 --dist loadfile --no-loadscope-reorder -m "not slow"

# Types are checked beside the tests: alone they leave a core idle for a minute.
test: style
	@$(MAKE) --no-print-directory -j 2 types tests

tests: venv
	@echo "== tests (two workers; the pass through the whole pipeline takes a few minutes)"
	@pytest -n 2 --dist loadfile --no-loadscope-reorder

params: venv
	@python -m stages.compose $(ARGS)

# What each stage imports, and a stage for every method of the table, into dvc.yaml.
deps: venv
	@python -m stages.deps

# What the documentation quotes of the code: the catalogue, what exports carry, what bad inputs bring.
pages: venv
	@python -m hybrid_dynamics.study.effect_pages docs/effects
	@python -m hybrid_dynamics.export.reference docs/export.md
	@python -m tests.bad_inputs

# The stages as a picture that GitHub and GitLab draw.
dag: venv
	@python -m stages.dag

ui: venv
	@mlflow ui --host 127.0.0.1 --port 5000 --backend-store-uri sqlite:///$(CURDIR)/mlflow.db

# QUICK=1: small sizes, once, at most three minutes. Peers of benchmarks/peers.txt count where bench-peers has run.
PEERS := $(CURDIR)/.venv-peers/bin/python
bench: venv
	@python -m benchmarks.bench $(if $(QUICK),--quick) $(if $(wildcard $(PEERS)),--peers $(PEERS)) $(ARGS)

bench-peers: venv
	@test -x $(PEERS) || $(PYTHON) -m venv --without-pip .venv-peers
	@# Everything else comes from the project's own environment (with its .pth files, hence addsitedir).
	@echo "import site; site.addsitedir('$(CURDIR)/$(VENV)/lib/python3.11/site-packages')" > .venv-peers/lib/python3.11/site-packages/shared.pth
	@python -m pip --python $(PEERS) install --quiet --disable-pip-version-check -r benchmarks/peers.txt

# Re-pin every dependency from what is installed (maintainers only).
lock: venv
	@python -m pip freeze --exclude-editable --all | grep -v '^pip==' | sed 's/+cpu$$//' > requirements.lock
