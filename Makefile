# Two commands do everything on a bare Python 3.11 to 3.14: `make book` and `make test`.
BIN := .venv/bin
READY := .venv/.ready
RUN := $(BIN)/dropout-uncertainty

.PHONY: help book pdf epub test check browser quick lab records verify bench clean
help: ## this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-8s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

book: $(READY) ## run the notebooks on the stored records and build the HTML
	$(RUN) book

pdf: $(READY) ## print the built book as one PDF, with Chromium
	$(RUN) pdf

epub: $(READY) ## make an EPUB of the built book, for e-readers
	$(RUN) epub

test: check ## style, types, import rules and all tests but the slow ones
	$(BIN)/python -m pytest --numprocesses auto

check: $(READY)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports

browser: $(READY) ## open the built book, and a notebook in JupyterLab, in Chromium and check what is to be seen
	$(BIN)/python -m pytest -m "" tests/page/test_book.py tests/page/test_browser.py tests/page/test_lab.py

quick: $(READY) ## compute everything live at reduced size, build the HTML from that, let PILCO learn the swing-up, and try the run for a GPU
	$(RUN) book --profile quick
	$(BIN)/python -m pytest -m slow tests/data_efficiency/pilco tests/test_gpu.py

lab: $(READY) ## open the notebooks in JupyterLab
	$(BIN)/jupyter lab notebooks

records: $(READY) ## compute the missing thesis-scale records (hours to days; continues where it stopped)
	$(RUN) book --profile full

verify: $(READY) ## check every stored record, and recompute the first steps of one of each section
	$(RUN) records verify --recompute 1

bench: $(READY) ## time the package beside other libraries
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[bench]'
	for script in benchmarks/*.py; do $(BIN)/python $$script || exit 1; done

clean: ## remove what was built; unfinished runs (records/.partial) stay
	rm -rf _build .pytest_cache .ruff_cache .mypy_cache .import_linter_cache

# The environment is made again when what it holds has changed.
$(READY): pyproject.toml constraints.txt
	@for python in $(PYTHON) python3.13 python3.12 python3.11 python3.14 python3 python; do \
	  if $$python -c 'import sys, venv; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' 2>/dev/null; then \
	    echo "Setting up .venv with $$($$python --version); the first time takes some minutes."; \
	    $$python -m venv .venv \
	      && $(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[book,test]' \
	      && touch $@; exit; \
	  fi; \
	done; echo "No Python 3.11, 3.12, 3.13 or 3.14 was found: install one, or name it with make PYTHON=..." >&2; exit 1
