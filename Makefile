# make            environment, rendered sample, training, notebooks, videos: all into output/
# make test       the tests
# make video VIDEO=path/to/drive.mp4
# make train DATA=path/to/folder   with vehicles/ and non-vehicles/ in it
# make clean      removes the environment and output/

PYTHON ?= python3
BIN := .venv/bin
SAMPLE := output/sample
PARAM ?= param/svc_pickle.p
PRESET ?= G

.PHONY: all notebooks test lint video train clean
.DELETE_ON_ERROR:

all: notebooks

.venv/installed: requirements.txt constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed")'
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -r requirements.txt
	touch $@

$(SAMPLE)/rendered: .venv/installed
	$(BIN)/python sample_data.py $(SAMPLE)
	touch $@

output/calib.p: $(SAMPLE)/rendered
	$(BIN)/python calibrate.py $(SAMPLE)/camera_cal --out $@

output/svc_pickle.p: $(SAMPLE)/rendered
	$(BIN)/python train.py $(SAMPLE)/vehicles $(SAMPLE)/non-vehicles --out $@

notebooks: output/svc_pickle.p output/calib.p
	$(BIN)/papermill image_pipeline.ipynb output/image_pipeline.ipynb \
		-p test_images $(SAMPLE)/test_images -p chessboards $(SAMPLE)/camera_cal \
		-p param output/svc_pickle.p -p calib output/calib.p
	$(BIN)/papermill video_pipeline.ipynb output/video_pipeline.ipynb \
		-p video $(SAMPLE)/videos/drive.mp4 -p output output \
		-p param output/svc_pickle.p -p calib output/calib.p
	@echo 'Look at output/drive.mp4, output/drive_split.mp4 and the notebooks in output/.'

test: .venv/installed
	$(BIN)/python -m pytest

lint: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

video: .venv/installed
	@test -n "$(VIDEO)" || { echo 'error: which video? make video VIDEO=path/to/drive.mp4'; exit 1; }
	$(BIN)/python detect.py "$(VIDEO)" --out output --param $(PARAM)

train: .venv/installed
	@test -n "$(DATA)" || { echo 'error: which data? make train DATA=path/to/folder'; exit 1; }
	$(BIN)/python train.py "$(DATA)/vehicles" "$(DATA)/non-vehicles" \
		--preset $(PRESET) --out $(PARAM)

clean:
	rm -rf .venv output
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
