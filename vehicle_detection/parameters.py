"""All parameters, each group that travels together as one frozen dataclass.

Every attribute states its unit and what it does; `__post_init__` states its range. Presets
stand below the class that they fill. This module imports nothing but the standard library.
"""

from __future__ import annotations

from dataclasses import dataclass

COLOR_SPACES = ("RGB", "YCrCb", "HSV", "HLS", "LUV", "YUV", "Lab", "gray")


def require_color(name: str) -> None:
    """Raise ValueError unless this is the name of a colour space."""
    if name not in COLOR_SPACES:
        raise ValueError(f"unknown colour space {name!r}: one of {', '.join(COLOR_SPACES)}")


def channel_count(color: str | None) -> int:
    """Channels of an image in this colour space."""
    return 1 if color == "gray" else 3


# ------------------------------------------------------------------------- frames


@dataclass(frozen=True)
class FrameParams:
    """Which frames are searched.

    Attributes
    ----------
    smallest_side : int
        In pixels: in smaller ones a vehicle is a few.
    tallest : float
        Height by width: a taller one, brought to the width of the others, is huge.
    """

    smallest_side: int = 64
    tallest: float = 4


DEFAULT_FRAME = FrameParams()


@dataclass(frozen=True)
class ReportParams:
    """Which frames of a video deserve a look.

    Attributes
    ----------
    sudden_growth : float
        A vehicle's height that changes by more from frame to frame, as a factor above 1.
    most_notable : int
        Frames that are listed.
    """

    sudden_growth: float = 1.25
    most_notable: int = 60


DEFAULT_REPORT = ReportParams()


# --------------------------------------------------------- the write-ups' pipeline


@dataclass(frozen=True)
class FeatureParams:
    """What is measured of a window. A colour of None leaves the group out.

    Attributes
    ----------
    spatial_color, hist_color, hog_color : str or None
        Colour space of each feature group, one of `COLOR_SPACES`.
    spatial_size : int
        The window is shrunk to this many pixels a side; divides `window_size`.
    hist_bins : int
        Bins of each channel's histogram over 0..256.
    hog_channel : int or "ALL"
        Channel of `hog_color` of which HOG is computed.
    orientations, pix_per_cell, cells_per_block : int
        HOG: bins over 180 degrees, pixels a cell, cells a block.
        `pix_per_cell` divides `window_size`.
    window_size : int
        Side of a training image, and of a window at scale 1, in pixels.
    """

    spatial_color: str | None = None
    spatial_size: int = 16
    hist_color: str | None = None
    hist_bins: int = 32
    hog_color: str | None = None
    hog_channel: int | str = "ALL"
    orientations: int = 9
    pix_per_cell: int = 8
    cells_per_block: int = 2
    window_size: int = 64

    def __post_init__(self):
        self._check_colors()
        if min(self.spatial_size, self.pix_per_cell, self.window_size) < 1:
            raise ValueError("spatial_size, pix_per_cell and window_size start at 1")
        if self.spatial_color and self.window_size % self.spatial_size:
            raise ValueError(
                f"spatial_size {self.spatial_size} does not divide "
                f"the window of {self.window_size} pixels"
            )
        if self.window_size % self.pix_per_cell:
            raise ValueError(
                f"pix_per_cell {self.pix_per_cell} does not divide "
                f"the window of {self.window_size} pixels"
            )
        if not 1 <= self.cells_per_block <= self.window_size // self.pix_per_cell:
            raise ValueError(f"{self.cells_per_block} cells per block do not fit a window")
        if min(self.orientations, self.hist_bins) < 1:
            raise ValueError("orientations and hist_bins start at 1")

    def _check_colors(self):
        groups = (self.spatial_color, self.hist_color, self.hog_color)
        if not any(groups):
            raise ValueError("no feature group is on: give at least one colour space")
        for color in groups:
            if color is not None:
                require_color(color)
        if self.hog_color and self.hog_channel not in ("ALL", 0, 1, 2):
            raise ValueError(f"hog_channel is 0, 1, 2 or 'ALL', not {self.hog_channel!r}")
        if self.hog_color == "gray" and self.hog_channel not in ("ALL", 0):
            raise ValueError("a gray image has no HOG channel but 0")

    @property
    def colors(self) -> set:
        """The colour spaces of the groups that are on."""
        return {self.spatial_color, self.hist_color, self.hog_color} - {None}

    @property
    def hog_channels(self) -> slice:
        """The channels of which HOG is computed, as a slice."""
        if self.hog_channel == "ALL":
            return slice(channel_count(self.hog_color))
        first = int(self.hog_channel)
        return slice(first, first + 1)

    @property
    def n_features(self) -> int:
        """Length of the feature vector of one window."""
        n = 0
        if self.spatial_color:
            n += self.spatial_size**2 * channel_count(self.spatial_color)
        if self.hist_color:
            n += self.hist_bins * channel_count(self.hist_color)
        if self.hog_color:
            cells = self.window_size // self.pix_per_cell
            blocks = cells - self.cells_per_block + 1
            per_channel = (blocks * self.cells_per_block) ** 2 * self.orientations
            n += per_channel * len(range(channel_count(self.hog_color))[self.hog_channels])
        return n


FEATURE_PRESETS = {
    "G": FeatureParams(
        spatial_color="HLS", spatial_size=16,
        hog_color="HLS", orientations=8, pix_per_cell=8, cells_per_block=1,
    ),
    "B": FeatureParams(
        spatial_color="YCrCb", spatial_size=32, hist_color="YCrCb", hist_bins=32,
        hog_color="YCrCb", orientations=9, pix_per_cell=8, cells_per_block=2,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class SearchParams:
    """Where windows lie. Lengths are pixels of a frame of `reference_size`.

    On a frame of another size, scales follow its width, because the field of view fills it,
    and bands follow its height, because the horizon lies at a share of it.

    Attributes
    ----------
    bands : tuple of (scale, top, bottom)
        Each scans the rows top..bottom with windows of scale * window_size.
    cells_per_step : int
        Distance between neighbouring windows, in HOG cells.
    threshold : float
        A window whose decision function is above it is hot.
    horizon : float or None
        Row in which the road vanishes. With it, only windows are visited in which a vehicle
        on the road could be: see `pipeline_functions.may_hold_vehicle`. None visits all.
    x_limits : (left, right) or None
        Only windows between these columns are visited. None visits all.
    scan_every : int
        All windows are visited in every so many frames of a video, and between them only
        those around places that were warm in the frame before.
    reference_size : (width, height)
    """

    bands: tuple
    cells_per_step: int = 2
    threshold: float = 0.0
    horizon: float | None = None
    x_limits: tuple | None = None
    scan_every: int = 1
    reference_size: tuple = (1280, 720)

    def __post_init__(self):
        object.__setattr__(self, "bands", tuple(map(tuple, self.bands)))
        if not self.bands:
            raise ValueError("a search needs at least one band of (scale, top, bottom)")
        width, height = self.reference_size
        for scale, top, bottom in self.bands:
            if scale <= 0 or not 0 <= top < bottom <= height:
                raise ValueError(f"not a band (scale, top, bottom): {(scale, top, bottom)}")
        if self.x_limits is not None and not 0 <= self.x_limits[0] < self.x_limits[1] <= width:
            raise ValueError(f"x_limits are (left, right) within 0..{width}, not {self.x_limits}")
        if min(self.cells_per_step, self.scan_every) < 1:
            raise ValueError("cells_per_step and scan_every start at 1")


SEARCH_PRESETS = {
    # The first band begins at 380 for G's stills and at 400 for its video. From 380 on, the
    # video too is searched as well as by G's own code, see docs/reproduction.md.
    "G": SearchParams(bands=((1, 380, 550), (2, 400, 650), (3, 400, 720), (4, 400, 720))),
    "B": SearchParams(bands=((1.6, 380, 660),)),
}


@dataclass(frozen=True)
class FilterParams:
    """How the heat of the last frames becomes boxes.

    Attributes
    ----------
    n_acc : int
        Heatmaps that are kept.
    n_occ_thr : int
        Heat that is one object in space and time must be seen in this many frames; at 1
        nothing is dropped.
    threshold : float
        The sum of the kept heatmaps must be above it.
    """

    n_acc: int
    n_occ_thr: int
    threshold: float

    def __post_init__(self):
        if not 1 <= self.n_occ_thr <= self.n_acc:
            raise ValueError(f"n_occ_thr {self.n_occ_thr} lies outside 1..{self.n_acc}")


FILTER_PRESETS = {
    "G": FilterParams(n_acc=15, n_occ_thr=4, threshold=12),
    "B": FilterParams(n_acc=10, n_occ_thr=1, threshold=25),
    # A still has no other frame to agree with: two windows have to.
    "still": FilterParams(n_acc=1, n_occ_thr=1, threshold=1),
}

METHODS = ("two-stage", "G", "B")


# ----------------------------------------------------------------------- calibration


@dataclass(frozen=True)
class CalibrationParams:
    """Which photos of a chessboard tell enough of a camera.

    Attributes
    ----------
    least_photos : int
        That show the whole board.
    least_tilt : float
        Of two boards against each other, in degrees. Parallel boards leave the focal length
        open.
    least_coverage : float
        Share of the picture within the hull of all corners. Lens distortion shows outside.
    """

    least_photos: int = 3
    least_tilt: float = 15
    least_coverage: float = 0.2


DEFAULT_CALIBRATION = CalibrationParams()


# ------------------------------------------------------------ the two-stage detector


@dataclass(frozen=True)
class ScanParams:
    """Where the first stage scans, and what it proposes.

    Attributes
    ----------
    smallest, largest : float
        Heights of windows, in pixels of a frame of `reference_width`. They follow the width
        of other frames, because the field of view fills it.
    reference_width : float
        In pixels.
    ratio : float
        Of the heights of neighbouring levels, above 1.
    cells_per_step : int
        Distance between neighbouring windows, in cells.
    n_groups : int
        A frame of a video visits one of so many groups of levels, in turn.
    threshold : float
        A window whose decision function is above it may become a proposal.
    n_proposals : int
        The best of each level that are refined. If they were taken from all levels together,
        the many small windows would crowd out the few large ones.
    overlap : float
        IoU above which the worse of two windows of a level is suppressed, between 0 and 1.
    """

    smallest: float = 26
    largest: float = 400
    reference_width: float = 1280
    ratio: float = 1.25
    cells_per_step: int = 2
    n_groups: int = 5
    threshold: float = 0.0
    n_proposals: int = 16
    overlap: float = 0.5

    def __post_init__(self):
        if not 0 < self.smallest <= self.largest:
            raise ValueError(f"heights {self.smallest} to {self.largest} are no range")
        if self.ratio <= 1:
            raise ValueError(f"neighbouring heights need a ratio above 1, not {self.ratio}")
        if min(self.cells_per_step, self.n_groups, self.n_proposals) < 1:
            raise ValueError("cells_per_step, n_groups and n_proposals start at 1")
        if not 0 < self.overlap < 1:
            raise ValueError(f"an overlap lies between 0 and 1, not at {self.overlap}")


DEFAULT_SCAN = ScanParams()


@dataclass(frozen=True)
class SelectionParams:
    """Which candidates of a frame remain.

    Attributes
    ----------
    max_iou, max_covered : float
        Two boxes are in conflict if their IoU, or the covered share of the smaller one, is
        above these. Vehicles that are both seen overlap less.
    whole_car_aspect : float
        A box wider than this by its height, away from the border, is a whole car. Lorries and
        vans are narrower, and would be taken for nearer cars.
    """

    max_iou: float = 0.5
    max_covered: float = 0.7
    whole_car_aspect: float = 1.1


DEFAULT_SELECTION = SelectionParams()


@dataclass(frozen=True)
class RoadParams:
    """What is known of road and camera before any vehicle is seen, and how vehicles tell more.

    Attributes
    ----------
    horizon : (float, float)
        Mean and standard deviation of the row in which the road vanishes, as shares of the
        frame's height. Cameras were met from 0.35 to 0.6.
    camera_to_car : (float, float)
        Mean and standard deviation of the height of the camera by that of a car.
    spread : float
        Standard deviation of a car's height, as a share of its height.
    lorry_to_car : float
        Height of the highest lorry, some four metres, by that of a car.
    n_frames : int
        Whose cars are remembered. Boxes that are none may hide the road, but no longer.
    n_std : float
        The scan covers so many standard deviations around what is expected.
    cost : float
        Score that a box loses, times half the square of its `road.misplacement`: the negative
        logarithm of a Gaussian.
    """

    horizon: tuple = (0.46, 0.08)
    camera_to_car: tuple = (0.95, 0.2)
    spread: float = 0.2
    lorry_to_car: float = 3
    n_frames: int = 100
    n_std: float = 2
    cost: float = 0.5

    def __post_init__(self):
        if min(*self.horizon, *self.camera_to_car) <= 0:
            raise ValueError("means and standard deviations of the road are above 0")
        if min(self.spread, self.n_frames, self.n_std) <= 0:
            raise ValueError("spread, n_frames and n_std are above 0")
        if self.lorry_to_car < 1 or self.cost < 0:
            raise ValueError("lorry_to_car starts at 1, cost at 0")


DEFAULT_ROAD = RoadParams()


@dataclass(frozen=True)
class DistanceParams:
    """What turns rows of the frame into metres.

    Attributes
    ----------
    camera_height : float or None
        Above the road, in metres; None takes the height of a car by the belief of the road.
    car_height : float
        In metres.
    n_std : float
        A vehicle must stand lower than the horizon by so many of its standard deviations.
    """

    camera_height: float | None = None
    car_height: float = 1.5
    n_std: float = 2

    def __post_init__(self):
        if self.car_height <= 0 or (self.camera_height is not None and self.camera_height <= 0):
            raise ValueError("heights are above 0")


DEFAULT_DISTANCE = DistanceParams()

# ----------------------------------------------------------------------- tracks


@dataclass(frozen=True)
class TrackParams:
    """How boxes become tracks.

    Attributes
    ----------
    min_iou : float
        Least IoU of a box with the prediction of its track, between 0 and 1.
    process_noise : float
        Standard deviation of the change of an edge's velocity from frame to frame, relative to
        that of the measured edge.
    confirm_at : float
        Accumulated score that makes a track a vehicle.
    max_score : float
        No track accumulates more, so that what has gone is soon dropped.
    score_offset : float
        Subtracted from every score; a frame without a box counts as a score of 0. What is no
        vehicle often keeps scores just above 0, and so loses its track. Only from this score on
        does a box tell of the road.
    """

    min_iou: float = 0.2
    process_noise: float = 0.1
    confirm_at: float = 0.0
    max_score: float = 1.0
    score_offset: float = 0.5

    def __post_init__(self):
        if not 0 < self.min_iou < 1:
            raise ValueError(f"min_iou lies between 0 and 1, not at {self.min_iou}")
        if min(self.process_noise, self.score_offset) <= 0:
            raise ValueError("process_noise and score_offset are above 0")
        if not 0 <= self.confirm_at <= self.max_score:
            raise ValueError(f"confirm_at {self.confirm_at} lies outside 0..{self.max_score}")


# Boxes from heat have lasted already: one is enough, and is remembered for two seconds.
HEAT_TRACKS = TrackParams(max_score=25.0)
# A prediction is scored where it lies, so these tracks follow faster.
DEFAULT_TRACKS = TrackParams(process_noise=0.15, confirm_at=1.0, max_score=8.0)


@dataclass(frozen=True)
class TwoStageParams:
    """All parameters of the two-stage detector.

    Attributes
    ----------
    scan : ScanParams
    selection : SelectionParams
    road : RoadParams
    tracks : TrackParams
    distance : DistanceParams
    mirrored : bool
        Whether the second stage looks at the mirror image of each box, too, and takes the mean.
        It is right more often, and takes twice as long.
    """

    scan: ScanParams = DEFAULT_SCAN
    selection: SelectionParams = DEFAULT_SELECTION
    road: RoadParams = DEFAULT_ROAD
    tracks: TrackParams = DEFAULT_TRACKS
    distance: DistanceParams = DEFAULT_DISTANCE
    mirrored: bool = False


VIDEO_PARAMS = TwoStageParams()
# A still is scanned at all scales at once, and has no other frame to agree with.
STILL_PARAMS = TwoStageParams(
    scan=ScanParams(smallest=24, cells_per_step=1, n_groups=1),
    tracks=TrackParams(),
    mirrored=True,
)


# --------------------------------------------------------------------- training


@dataclass(frozen=True)
class AugmentationParams:
    """How frames and images are varied: what other cameras would have done to them.

    Chances are from 0 to 1, pairs are ranges.

    Attributes
    ----------
    cut_chance, side_chance : float
        That a frame is cut, and then on each side.
    most_cut : (float, float, float, float)
        Largest shares cut off at the left, top, right and bottom.
    least_visible : float
        Share of a vehicle that must be left to be learned from. A vehicle that enters must be
        found from half on: by then its track has accumulated some score.
    least_height : float
        Of a vehicle to learn from, in pixels: a lower one shows too little.
    least_aspect : float
        Width by height of a vehicle to learn from.
    camera_chance, scale_chance : float
        That size, focus and exposure are changed at all; that the size is.
    scales, crop_scales, shrinks : (float, float)
        Of frames, of images of the training set, and of patches.
    blur_chance, blurs : float, (float, float)
        Standard deviation of a Gaussian, in pixels.
    jpeg_chance, jpeg_qualities : float, (int, int)
        Of compression.
    exposure_chance, gain, white_balance, gamma : float
        Standard deviations of the logarithms: of all channels, of each, of the exponent.
    haze_chance, haze : float
        Largest share of white that is mixed in.
    saturation_chance, saturations : float, (float, float)
        1 leaves colours as they are.
    degrade_chance, shrink_chance, shade_chance : float
        That a patch is made worse, that it loses pixels, and that it loses contrast.
    most_black, least_contrast : float
        Grey levels: of what is black, and from there to white.
    crop_side : int
        Side of the training set's images, in pixels.
    """

    cut_chance: float = 0.5
    side_chance: float = 0.5
    most_cut: tuple = (0.4, 0.25, 0.4, 0.4)
    least_visible: float = 1 / 3
    least_height: float = 13
    least_aspect: float = 1 / 3
    camera_chance: float = 0.8
    scale_chance: float = 0.6
    scales: tuple = (0.4, 1)
    crop_scales: tuple = (0.25, 1)
    shrinks: tuple = (0.22, 0.88)
    blur_chance: float = 0.4
    blurs: tuple = (0.3, 1.0)
    jpeg_chance: float = 0.5
    jpeg_qualities: tuple = (25, 90)
    exposure_chance: float = 0.7
    gain: float = 0.25
    white_balance: float = 0.06
    gamma: float = 0.3
    haze_chance: float = 0.4
    haze: float = 0.12
    saturation_chance: float = 0.45
    saturations: tuple = (0.3, 1.4)
    degrade_chance: float = 0.5
    shrink_chance: float = 0.7
    shade_chance: float = 0.5
    most_black: float = 80
    least_contrast: float = 60
    crop_side: int = 64


DEFAULT_AUGMENTATION = AugmentationParams()


@dataclass(frozen=True)
class TrainingParams:
    """How much is learned from, and how large the learned machines are.

    Attributes
    ----------
    per_camera : int
        Frames of each camera that are learned from: more are thinned out, fewer repeated.
    most_repeats : int
        So often at most; every time is varied anew.
    crop_views : int
        So often is each boxed crop varied.
    window_jitter : float
        Standard deviation of the edges of a vehicle's window, in widths and heights. The first
        stage's windows lie on a grid of cells, and are off by up to half a step.
    shift_jitter : float
        The same of the windows from which the edges of vehicles are sought.
    vehicle_iou, background_iou : float
        A box that overlaps a vehicle by more than the first is one, by less than the second
        is background; what lies between teaches neither.
    mining_rounds, mining_frames : int
        Of hard negatives of the first stage.
    n_random : int
        Windows of background a frame and template, at random places.
    template_C, template_alpha, machine_C, machine_alpha : float
        Regularisation of the SVMs and of the ridge regressions of both stages.
    machine_size : (int, int)
        Components of patches, and centers.
    vehicle_score : float
        Median score of the vehicles that were learned from.
    most_patches : int
        That the second stage is fitted to, at random among all: each takes a number a center in
        memory.
    sure_score : float
        A patch that is scored right by more than this teaches nothing new.
    """

    per_camera: int = 250
    most_repeats: int = 6
    crop_views: int = 8
    window_jitter: float = 0.08
    shift_jitter: float = 0.1
    vehicle_iou: float = 0.6
    background_iou: float = 0.4
    mining_rounds: int = 2
    mining_frames: int = 300
    n_random: int = 6
    template_C: float = 5e-4
    template_alpha: float = 3000.0
    machine_C: float = 0.1
    machine_alpha: float = 1.0
    machine_size: tuple = (200, 4000)
    vehicle_score: float = 1.5
    most_patches: int = 100_000
    sure_score: float = 0.5

    def __post_init__(self):
        if min(self.per_camera, self.most_repeats, self.crop_views) < 1:
            raise ValueError("per_camera, most_repeats and crop_views start at 1")
        if not 0 < self.background_iou <= self.vehicle_iou < 1:
            raise ValueError("background_iou and vehicle_iou rise between 0 and 1")


DEFAULT_TRAINING = TrainingParams()
# For machines without footage, and to rank settings quickly.
QUICK_TRAINING = TrainingParams(per_camera=150, crop_views=4)
