# make            environment, classifier, executed notebooks, annotated videos: all into output/
# make test       the tests
# make fuzz       ten thousand damaged files of each kind: some minutes
# make mutants    how many small changes of the deciding modules the tests notice: five minutes
# make data       the course's images and videos into data/ [FROM=archives MIRROR=url]
# make real       train on them, the notebooks on them, the annotated project video
# make lint       style, types of public functions
# make video VIDEO=path/to/drive.mp4 [OPTIONS=--overwrite]
# make train DATA=path/to/folder   with vehicles/ and non-vehicles/ in it
# make detector   the two-stage detector, trained on rendered scenes alone
# make evaluate   boxes against the truth: the shipped clip, and real footage if there is some
# make docs       the executed notebooks as Markdown into docs/
# make clean      removes the environment and output/

PYTHON ?= python3
BIN := .venv/bin
DETECTOR ?= param/detector.npz
PRESET ?= G
# Recipes see them as variables of the shell, which it takes as they are.
export VIDEO FROM MIRROR DATA DETECTOR PRESET PYTHON
REAL := ../shared
# Boxes of the project video, if there are some.
TRUTH := $(wildcard $(REAL)/truth/project_video.gt.txt)
NOTEBOOKS := image_pipeline video_pipeline two_stage

.PHONY: all data real notebooks test fuzz mutants test-dask lint video train detector evaluate docs clean
.DELETE_ON_ERROR:

all: notebooks

.venv/installed: requirements.txt constraints.txt
	"$$PYTHON" -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed")'
	"$$PYTHON" -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -r requirements.txt
	touch $@

output/svc_pickle.p: .venv/installed
	$(BIN)/python train.py

notebooks: output/svc_pickle.p
	for name in $(NOTEBOOKS); do \
		$(BIN)/papermill --no-progress-bar $$name.ipynb output/$$name.ipynb -p output output/$$name \
			-y "{overwrite: true, widgets: false}" || exit 1; \
	done
	@echo 'Look at the notebooks and videos in output/.'

test: .venv/installed
	$(BIN)/python -m pytest

fuzz: .venv/installed
	$(BIN)/python -m pytest tests/fuzz_files.py

mutants: .venv/installed
	$(BIN)/pip install --quiet --disable-pip-version-check -r requirements-mutants.txt
	$(BIN)/mutmut run
	$(BIN)/mutmut results

test-dask: .venv/installed
	$(BIN)/pip install --quiet --disable-pip-version-check -r requirements-dask.txt
	$(BIN)/python -m pytest tests/experiments tests/test_detect.py tests/compiled -k "dask or scheduler"

lint: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

video: .venv/installed
	@test -n "$$VIDEO" || { echo 'error: which video? make video VIDEO=path/to/drive.mp4'; exit 1; }
	$(BIN)/python detect.py --param "$$DETECTOR" $(OPTIONS) -- "$$VIDEO"

train: .venv/installed
	@test -n "$$DATA" || { echo 'error: which data? make train DATA=path/to/folder'; exit 1; }
	$(BIN)/python train.py --preset "$$PRESET" -- "$$DATA"

detector: .venv/installed
	for scene in motorway town; do \
		$(BIN)/python -m rendered_road.sample output/scenes/$$scene --only training --scenes 250 \
			--scene $$scene || exit 1; \
	done
	$(BIN)/python -m vehicle_detection.two_stage.training --out output/detector.npz \
		--footage output/scenes/motorway/scenes output/scenes/motorway/scenes.gt.txt \
		--footage output/scenes/town/scenes output/scenes/town/scenes.gt.txt

data: .venv/installed
	$(BIN)/python -m vehicle_detection.media.download $${FROM:+--from "$$FROM"} $${MIRROR:+--mirror "$$MIRROR"}

real: .venv/installed
	@test -d data/vehicles || { echo 'error: no data/: make data first'; exit 1; }
	$(BIN)/python train.py data --out output/real/svc_pickle.p
	$(BIN)/papermill --no-progress-bar image_pipeline.ipynb output/real/image_pipeline.ipynb \
		-p test_images data/test_images -p param output/real/svc_pickle.p -p widgets False
	for name in video_pipeline two_stage; do \
		$(BIN)/papermill --no-progress-bar $$name.ipynb output/real/$$name.ipynb \
			-p output output/real/$$name -p param output/real/svc_pickle.p \
			-y "{overwrite: true, video: data/project_video.mp4, truth: '$(TRUTH)', first_frame: 240}" || exit 1; \
	done

evaluate: .venv/installed
	$(BIN)/python detect.py --overwrite --param "$$DETECTOR"
	$(BIN)/python -m vehicle_detection.evaluation videos/drive.gt.txt output/drive.txt
	@if [ -f $(REAL)/truth/project_video.gt.txt ]; then \
		$(BIN)/python detect.py $(REAL)/udacity/project_video.mp4 --overwrite --param "$$DETECTOR" && \
		for frames in 1:630 631:1260; do \
			echo "project_video.mp4, frames $$frames"; \
			$(BIN)/python -m vehicle_detection.evaluation $(REAL)/truth/project_video.gt.txt \
				output/project_video.txt --frames $$frames || exit 1; \
		done; \
	else echo 'skipped: no real video in $(REAL)'; fi

docs: notebooks
	for name in $(NOTEBOOKS); do \
		$(BIN)/python -m experiments.executed output/$$name.ipynb docs/$$name.md || exit 1; \
	done

clean:
	rm -rf .venv output
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
