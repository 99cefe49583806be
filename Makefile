# Everything is installed into .venv; `make demo` and `make test` each do their own set-up.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# CPU builds of torch are on this index; pip continues with its other sources if it is not reachable.
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
# Two test processes with one thread each are faster than one with two threads.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2

.PHONY: demo test test-slow test-all fuzz lint docs clean

demo: $(VENV)/installed
	$(BIN)/python -m sim corner_letter -o out/demo/frames --frames 2 --seed 1
	$(BIN)/python -m invert out/demo/frames -o out/demo --truth out/demo/frames/truth.npy
	@echo "Open out/demo/report.png"

test: $(VENV)/installed
	$(PYTEST) -m "not slow"

# Seconds since the epoch after which no slow test begins; empty for all of them.
UNTIL ?=
test-slow: $(VENV)/installed
	$(PYTEST) -v -m slow $(if $(UNTIL),--until $(UNTIL))

test-all: test test-slow

fuzz: $(VENV)/installed
	FUZZ_EXAMPLES=$${FUZZ_EXAMPLES:-1000} FUZZ_KILLS=$${FUZZ_KILLS:-50} $(BIN)/python -m pytest tests/fuzz

lint: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --editable ".[lint]"
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	$(BIN)/pyright --pythonpath $(BIN)/python

docs: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --editable ".[docs]"
	$(BIN)/sphinx-build -q -W --keep-going docs out/docs
	@echo "Open out/docs/index.html"

$(VENV)/installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --retries 1 --extra-index-url $(TORCH_INDEX) "torch>=2.6,<2.14"
	$(BIN)/python -m pip install --quiet --editable ".[test]"
	.ci/libllvm $(BIN)/python
	touch $@

clean:
	rm -rf $(VENV) out *.egg-info
