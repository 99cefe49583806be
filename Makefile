# Everything installs into .venv; `make demo` and `make test` each do their own set-up.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# CPU builds of torch live here; where it cannot be reached, pip goes on with what else it has.
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu

.PHONY: demo test test-quick fuzz lint docs clean

demo: $(VENV)/installed
	$(BIN)/python -m sim scenes/corner_letter/scene.xml -o out/demo/frames --frames 2 --seed 1
	$(BIN)/python -m invert out/demo/frames -o out/demo --truth out/demo/frames/truth.npy
	@echo "Look at out/demo/report.png"

test: $(VENV)/installed
	$(BIN)/python -m pytest

test-quick: $(VENV)/installed
	$(BIN)/python -m pytest -m "not slow"

fuzz: $(VENV)/installed
	FUZZ_EXAMPLES=$${FUZZ_EXAMPLES:-1000} FUZZ_KILLS=$${FUZZ_KILLS:-50} $(BIN)/python -m pytest tests/fuzz

lint: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --editable ".[lint]"
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	$(BIN)/pyright --pythonpath $(BIN)/python

docs: $(VENV)/installed
	$(BIN)/python -m pip install --quiet --editable ".[docs]"
	$(BIN)/sphinx-build -q -W --keep-going docs out/docs
	@echo "Look at out/docs/index.html"

$(VENV)/installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --retries 1 --extra-index-url $(TORCH_INDEX) "torch>=2.6,<2.14"
	$(BIN)/python -m pip install --quiet --editable ".[test]"
	.ci/libllvm $(BIN)/python
	touch $@

clean:
	rm -rf $(VENV) out *.egg-info
