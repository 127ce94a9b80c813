# make setup   everything into .venv, the native library built
# make demo    a small street, a scene trained on it and its edits, in pictures
# make test    lint, types, import rules, tests
# make test-slow   tests that take long beside what they show: trainings, Cycles, a run of PPO
# make test-stress   tracers, lenses, readers and the closed loop at the limits of numbers
# make test-ray   batches on Ray, which it installs (200 MB): lost workers, tokens, ports; two minutes
# make test-s3   batches and inputs in S3, on moto's server; a part of make test
# make test-gs   batches and inputs in Google's storage, on an emulator, which it installs with gcsfs (60 MB)
# make test-schemas   MCAP files and Kubernetes' job by Foxglove's and Kubernetes' own schemas, which it installs (160 MB)
# make test-perception   trains the detectors of examples/perception, tests it and lets it drive: half an hour
# make test-inputs   100 000 broken files for the readers: an hour or two
# make test-calls   10 000 broken and random calls to unisim serve: some minutes
# make test-ui   a real Blender window driven by scripts, mouse and keys (root, debootstrap); a part of the sessions
# make test-ui-all   all of its sessions, in Blender 4.3 and 5.2
# make test-bpy BPY=5.2.3 PYTHON=python3.13   tests/blender with another release of Blender's module, which it installs
# make screenshots   the documentation's pictures of Blender, by two sessions of the window
# make cuda    the kernels for NVIDIA GPUs, by CUDA's compiler, which it installs (400 MB)
# make docs    the documentation as a website, in out/site
# make extension   the Blender extension as a .zip, in dist/
# make clean   removes what the others made, .venv included
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
BUILD_TOOLS := scikit-build-core cmake ninja
# each worker takes its half in order, so fixtures of a file are made once; who is done first takes from the other
WORKERS := -n 2 --dist worksteal
# tests start hundreds of processes, which read the package's bytecode
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup demo test test-slow test-stress test-ray test-s3 test-gs test-schemas test-perception test-inputs test-calls test-ui test-ui-all test-bpy screenshots cuda docs extension clean

setup: $(VENV)/.built

$(VENV)/.created:
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is needed and was not found; name another with: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	@command -v $${CXX:-c++} >/dev/null || { echo "a C++17 compiler is needed and was not found (Debian: apt-get install g++)" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	touch $@

# Dependencies are installed ahead of the package, so that a changed kernel costs a compilation and nothing else.
$(VENV)/.installed: $(VENV)/.created pyproject.toml constraints.txt
	$(BIN)/python -m pip install --quiet --constraint constraints.txt $(BUILD_TOOLS)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --no-build-isolation --editable '.[torch,ncore,parquet,dev]'
	touch $@

FORCE:

# An editable installation knows modules by name: it is made again when one is added, moved or removed.
$(VENV)/.modules: $(VENV)/.created FORCE
	@find unisim_blender unisim_bench unisim_street -name '*.py' | LC_ALL=C sort | cmp -s - $@ || \
	  find unisim_blender unisim_bench unisim_street -name '*.py' | LC_ALL=C sort > $@

$(VENV)/.built: $(VENV)/.installed $(VENV)/.modules CMakeLists.txt unisim_blender.pth unisim_gymnasium.py $(wildcard native/* native/*/*)
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	touch $@

# Blender's module is a gigabyte that the demo can do without.
$(VENV)/.blender: $(VENV)/.built
	$(BIN)/python -m pip install --quiet --constraint constraints.txt bpy==5.0.1
	touch $@

demo: setup
	$(BIN)/unisim demo

# types and import rules are checked beside the tests; what is found is printed after them
test: $(VENV)/.blender
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	@mkdir -p out
	@echo "$(BIN)/mypy && $(BIN)/lint-imports"; { $(BIN)/mypy && $(BIN)/lint-imports; } > out/types.txt 2>&1 & types=$$!; \
	OMP_NUM_THREADS=1 $(BIN)/pytest $(WORKERS); code=$$?; \
	wait $$types || code=$$?; cat out/types.txt; exit $$code

test-slow: $(VENV)/.blender
	OMP_NUM_THREADS=1 $(BIN)/pytest $(WORKERS) -m slow

test-stress: setup
	OMP_NUM_THREADS=1 $(BIN)/pytest $(WORKERS) -m stress

$(VENV)/.ray: $(VENV)/.built
	$(BIN)/python -m pip install --quiet --constraint constraints.txt 'ray[client]'
	touch $@

test-ray: $(VENV)/.ray
	OMP_NUM_THREADS=1 $(BIN)/pytest -m 'slow or not slow' tests/core/executors

test-s3: setup
	OMP_NUM_THREADS=1 $(BIN)/pytest tests/core/batch/test_batch_s3.py tests/core/remote

$(VENV)/.gs: $(VENV)/.built
	$(BIN)/python -m pip install --quiet --constraint constraints.txt gcsfs gcp-storage-emulator
	touch $@

test-gs: $(VENV)/.gs
	OMP_NUM_THREADS=1 $(BIN)/pytest tests/core/batch/test_batch_gs.py

$(VENV)/.schemas: $(VENV)/.built
	$(BIN)/python -m pip install --quiet --constraint constraints.txt foxglove-sdk kubernetes-validate
	touch $@

test-schemas: $(VENV)/.schemas
	$(BIN)/pytest tests/core/formats/mcap/test_foxglove_schemas.py tests/core/batch/test_batch_shards.py

# the detectors are kept in PERCEPTION; their training goes on there
PERCEPTION ?= out/perception
test-perception: setup
	$(BIN)/python -m examples.perception.train $(PERCEPTION)
	PERCEPTION_WEIGHTS=$(PERCEPTION) $(BIN)/pytest -m 'perception or not slow' tests/core/perception

# failures are kept in .hypothesis and tried first the next time
test-inputs: setup
	HYPOTHESIS_PROFILE=many OMP_NUM_THREADS=1 $(BIN)/pytest tests/core/inputs --hypothesis-show-statistics

test-calls: setup
	UNISIM_FUZZED_CALLS=10000 $(BIN)/pytest tests/core/serve/test_fuzzed_calls.py

# releases of Blender's module have a Python each; the environment in out/ is as large as .venv
BPY ?= 5.2.3
test-bpy:
	$(PYTHON) -m venv out/bpy-$(BPY)
	out/bpy-$(BPY)/bin/python -m pip install --quiet $(BUILD_TOOLS) bpy==$(BPY)
	out/bpy-$(BPY)/bin/python -m pip install --quiet --no-build-isolation -C build-dir=out/bpy-$(BPY)/native --editable '.[torch,parquet,ncore,batch]' hypothesis pytest pytest-xdist
	OMP_NUM_THREADS=1 out/bpy-$(BPY)/bin/pytest $(WORKERS) tests/blender

# a real Blender window, in a Debian of its own below BLENDER_ROOT: needs root and debootstrap
# MINUTES=10: no session begins after ten minutes
BLENDER_ROOT ?= /var/tmp/unisim-blender
test-ui: $(VENV)/.blender
	$(BIN)/python tests/ui/run.py $(BLENDER_ROOT)-trixie trixie out/ui --ci$(if $(MINUTES), --minutes $(MINUTES))

# every session, in Debian's two newest Blenders (4.3 and 5.2)
test-ui-all: $(VENV)/.blender
	$(BIN)/python tests/ui/run.py $(BLENDER_ROOT)-trixie trixie out/ui
	$(BIN)/python tests/ui/run.py $(BLENDER_ROOT)-sid sid out/ui-sid

screenshots: $(VENV)/.blender
	$(BIN)/python tests/ui/run.py $(BLENDER_ROOT)-trixie trixie out/ui window compare layouts
	$(BIN)/python tools/screenshots.py out/ui docs/images

# an environment of its own: the website needs neither the package nor a compiler
DOCS_VENV := .venv-docs
DOCS_NEED := import tomllib; print(*tomllib.load(open('pyproject.toml', 'rb'))['project']['optional-dependencies']['docs'])
$(DOCS_VENV)/.created: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(DOCS_VENV)
	$(DOCS_VENV)/bin/python -m pip install --quiet --constraint constraints.txt $$($(PYTHON) -c "$(DOCS_NEED)")
	touch $@

docs: $(DOCS_VENV)/.created
	NO_MKDOCS_2_WARNING=1 $(DOCS_VENV)/bin/mkdocs build --strict

# CUDA's compiler in an environment of its own; it needs no GPU
CUDA_VENV := .venv-cuda
$(CUDA_VENV)/.created: constraints.txt
	$(PYTHON) -m venv $(CUDA_VENV)
	$(CUDA_VENV)/bin/python -m pip install --quiet --constraint constraints.txt nvidia-cuda-nvcc nvidia-cuda-cccl
	touch $@

cuda: $(CUDA_VENV)/.created
	$(CUDA_VENV)/bin/python tools/compile_cuda.py unisim_blender/core/_unisim_cuda.fatbin

extension: $(VENV)/.blender
	$(BIN)/python tools/build_extension.py dist

clean:
	rm -rf $(VENV) $(DOCS_VENV) $(CUDA_VENV) build dist out unisim_blender/core/_unisim_native.* unisim_blender/core/_unisim_cuda.fatbin
