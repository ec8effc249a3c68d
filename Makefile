# make            environment, rendered sample, training, notebooks, videos: all into output/
# make test       the tests
# make video VIDEO=path/to/drive.mp4
# make evaluate   the boxes of the sample's video against the truth, and of the real one if there
# make train DATA=path/to/folder   with vehicles/ and non-vehicles/ in it
# make clean      removes the environment and output/

PYTHON ?= python3
BIN := .venv/bin
SAMPLE := output/sample
DETECTOR ?= param/detector.npz
PARAM ?= param/svc_pickle.p
PRESET ?= G
REAL := ../shared

.PHONY: all notebooks test test-dask lint video train evaluate clean
.DELETE_ON_ERROR:

all: notebooks

.venv/installed: requirements.txt constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed")'
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -r requirements.txt
	touch $@

$(SAMPLE)/rendered: .venv/installed render.py sample_data.py
	$(BIN)/python sample_data.py $(SAMPLE)
	touch $@

output/calib.p: $(SAMPLE)/rendered
	$(BIN)/python calibrate.py $(SAMPLE)/camera_cal --out $@

output/svc_pickle.p: $(SAMPLE)/rendered
	$(BIN)/python train.py $(SAMPLE)/vehicles $(SAMPLE)/non-vehicles --out $@

output/detector.npz: $(SAMPLE)/rendered
	$(BIN)/python train_detector.py --footage $(SAMPLE)/scenes $(SAMPLE)/scenes.gt.txt --out $@

notebooks: output/svc_pickle.p output/detector.npz output/calib.p
	$(BIN)/papermill image_pipeline.ipynb output/image_pipeline.ipynb \
		-p test_images $(SAMPLE)/test_images -p chessboards $(SAMPLE)/camera_cal \
		-p param output/svc_pickle.p -p detector output/detector.npz -p calib output/calib.p
	$(BIN)/papermill video_pipeline.ipynb output/video_pipeline.ipynb \
		-p video $(SAMPLE)/videos/drive.mp4 -p truth $(SAMPLE)/videos/drive.gt.txt -p output output \
		-p param output/svc_pickle.p -p detector output/detector.npz -p calib output/calib.p
	@echo 'Look at output/drive.mp4, output/drive_split.mp4 and the notebooks in output/.'

test: .venv/installed
	$(BIN)/python -m pytest

test-dask: .venv/installed
	$(BIN)/pip install --quiet --disable-pip-version-check -r requirements-dask.txt
	$(BIN)/python -m pytest tests/test_experiments.py

lint: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

video: .venv/installed
	@test -n "$(VIDEO)" || { echo 'error: which video? make video VIDEO=path/to/drive.mp4'; exit 1; }
	$(BIN)/python detect.py "$(VIDEO)" --out output --param $(DETECTOR)

train: .venv/installed
	@test -n "$(DATA)" || { echo 'error: which data? make train DATA=path/to/folder'; exit 1; }
	$(BIN)/python train.py "$(DATA)/vehicles" "$(DATA)/non-vehicles" \
		--preset $(PRESET) --out $(PARAM)

evaluate: .venv/installed
	@test -f output/drive.txt || { echo 'error: no boxes yet: run make first'; exit 1; }
	$(BIN)/python evaluate.py $(SAMPLE)/videos/drive.gt.txt output/drive.txt \
		--picture output/drive_evaluation.png
	@if [ -f $(REAL)/truth/project_video.gt.txt ]; then \
		$(BIN)/python detect.py $(REAL)/udacity/project_video.mp4 --out output --param $(DETECTOR) && \
		for frames in 1:630 631:1260; do \
			echo "project_video.mp4, frames $$frames"; \
			$(BIN)/python evaluate.py $(REAL)/truth/project_video.gt.txt \
				output/project_video.txt --frames $$frames || exit 1; \
		done; \
	else echo 'skipped: no real video in $(REAL)'; fi

clean:
	rm -rf .venv output
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
