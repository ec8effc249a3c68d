"""A rendered motorway: frames of a front camera, with exact boxes of the vehicles.

    road and weather -> ground -> roadside -> vehicles -> lens -> sensor

Positions are in metres: x to the right and y up from the middle of the road,
z forward from the camera. A world is made from a seed, and a frame of it from
a world and a time, so any frame can be rendered on its own.
"""

from dataclasses import dataclass, field
from functools import lru_cache

import cv2
import numpy as np

from vehicle_detection.compiled.cache import compiled

LANE_WIDTH = 3.7
_FAR = 420.0
_HAZE = np.float32((0.7, 0.76, 0.82))
# Up to here the lens's distortion keeps the order of points.
_WIDEST_TANGENT = 1.1

# -------------------------------------------------------------------- camera


@dataclass(frozen=True)
class Camera:
    """A camera with barrel distortion, as a calibration is to find it again.

    Attributes
    ----------
    width, height : int
        Of the frame, in pixels.
    focal : float
        Focal length, in pixels.
    center : (float, float)
        Principal point, in pixels.
    dist : tuple of float
        Distortion k1, k2, p1, p2, k3.
    mount_height : float
        Above the road, in metres.
    horizon_below : float
        How far the horizon lies below the principal point, in pixels: the pitch.
    """

    width: int = 1280
    height: int = 720
    focal: float = 1150.0
    center: tuple = (648.0, 378.0)
    dist: tuple = (-0.24, 0.02, 0.0, 0.0, -0.01)
    mount_height: float = 1.35
    horizon_below: float = 32.0

    @property
    def mtx(self):
        """Camera matrix, ndarray of float, shape (3, 3)."""
        (x, y), f = self.center, self.focal
        return np.array([[f, 0, x], [0, f, y], [0, 0, 1]])

    def project(self, points):
        """Points of shape (n, 3), camera coordinates with y down, to distorted pixels.

        Points at more than `_WIDEST_TANGENT` from the axis, all far outside of
        the frame, are taken there: beyond it the polynomial turns back.
        """
        rays = np.asarray(points, float)[..., :2] / np.asarray(points, float)[..., 2:]
        tangent = np.linalg.norm(rays, axis=1, keepdims=True)
        rays = rays * np.minimum(1, _WIDEST_TANGENT / np.maximum(tangent, 1e-9))
        rays = np.hstack([rays, np.ones((len(rays), 1))])
        pixels, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), self.mtx, np.array(self.dist))
        return pixels[:, 0]


@lru_cache(maxsize=8)
def _lens(camera):
    """Size and origin of the ideal picture behind a frame, and the maps between them."""
    x, y = np.meshgrid(
        np.arange(camera.width, dtype=np.float32), np.arange(camera.height, dtype=np.float32)
    )
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)[:, None]
    ideal = cv2.undistortPoints(pixels, camera.mtx, np.array(camera.dist), P=camera.mtx)
    ideal = ideal.reshape(camera.height, camera.width, 2)
    origin = np.floor(ideal.min(axis=(0, 1))) - 2
    size = np.ceil(ideal.max(axis=(0, 1)) - origin).astype(int) + 3
    return size, origin, (ideal - origin).astype(np.float32)


def through_lens(camera, picture):
    """An ideal picture, as large as `_lens` says, as the camera would see it."""
    maps = _lens(camera)[2]
    return cv2.remap(picture, maps, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def perspective_through_lens(camera, board, corners, pixels, background):
    """A flat gray picture hung in front of the camera.

    Parameters
    ----------
    camera : Camera
    board : ndarray of uint8, shape (rows, columns)
    corners, pixels : ndarray of float, shape (4, 2)
        Four points of the board, and where an ideal camera sees them.
    background : int
        Gray value around it.
    """
    size, origin, _ = _lens(camera)
    matrix = cv2.getPerspectiveTransform(
        corners.astype(np.float32), (pixels - origin).astype(np.float32)
    )
    picture = cv2.warpPerspective(
        board, matrix, tuple(int(side) for side in size), flags=cv2.INTER_AREA,
        borderValue=background,
    )  # fmt: skip
    return through_lens(camera, picture)


# --------------------------------------------------------------------- noise


@lru_cache(maxsize=64)
def _noise_tile(seed, size=512, octaves=6):
    """Smooth noise that repeats seamlessly, mean 0, standard deviation 1."""
    rng = np.random.default_rng(seed)
    tile = np.zeros((size, size), np.float32)
    for octave in range(1, octaves + 1):
        coarse = rng.normal(size=(2**octave, 2**octave)).astype(np.float32)
        wrapped = np.pad(coarse, 2, mode="wrap")
        cell = size // 2**octave
        fine = cv2.resize(wrapped, None, fx=cell, fy=cell, interpolation=cv2.INTER_CUBIC)
        tile += fine[2 * cell : -2 * cell, 2 * cell : -2 * cell] * 0.75**octave
    return (tile - tile.mean()) / tile.std()


def _noise(seed, x, y, period):
    """Noise at positions of any shape, repeating after `period` in both directions."""
    tile = _noise_tile(seed)
    size = tile.shape[0]
    scale = np.float32(size / period)
    x, y = np.broadcast_arrays(np.asarray(x, np.float32), np.asarray(y, np.float32))
    column, row = x * scale, y * scale
    # The whole part of the period is taken off first: remap takes small numbers only.
    column -= size * np.floor(column / np.float32(size))
    row -= size * np.floor(row / np.float32(size))
    return cv2.remap(tile, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


# ------------------------------------------------------------------ vehicles

PAINT, GLASS, RUBBER, DARK, BOX = range(5)

PAINTS = (
    (0.86, 0.87, 0.88), (0.92, 0.92, 0.90), (0.06, 0.06, 0.07), (0.10, 0.11, 0.13),
    (0.30, 0.31, 0.33), (0.55, 0.57, 0.59), (0.68, 0.70, 0.72), (0.45, 0.05, 0.06),
    (0.60, 0.08, 0.07), (0.07, 0.12, 0.32), (0.12, 0.24, 0.48), (0.30, 0.42, 0.55),
    (0.10, 0.22, 0.15), (0.36, 0.30, 0.22), (0.62, 0.56, 0.44), (0.75, 0.55, 0.10),
)  # fmt: skip


@dataclass(frozen=True)
class Body:
    """Shape of one kind of vehicle.

    Attributes
    ----------
    length, width, height : float
        In metres.
    profile : tuple of (z, height)
        Outline from the rear forwards, as shares of length and height.
    belt : float
        Lower edge of the windows, share of height.
    cabin : (z, z)
        Where side windows begin and end, share of length.
    lights : (inner, bottom, top)
        Rear lights: from this share of the half width out, shares of height.
    plate : float
        Height of the number plate, share of height.
    """

    length: float
    width: float
    height: float
    profile: tuple
    belt: float
    cabin: tuple
    lights: tuple
    plate: float


BODIES = {
    "saloon": Body(
        4.7, 1.83, 1.45,
        ((0, 0.60), (0.008, 0.71), (0.03, 0.735), (0.15, 0.75), (0.29, 0.955), (0.42, 1.0),
         (0.58, 0.98), (0.74, 0.73), (0.93, 0.62), (0.985, 0.52), (1, 0.40)),
        0.68, (0.20, 0.72), (0.52, 0.53, 0.67), 0.52,
    ),
    "estate": Body(
        4.5, 1.80, 1.50,
        ((0, 0.52), (0.008, 0.63), (0.025, 0.67), (0.075, 0.93), (0.12, 0.985), (0.30, 1.0),
         (0.58, 0.98), (0.75, 0.70), (0.93, 0.60), (0.985, 0.50), (1, 0.38)),
        0.64, (0.09, 0.72), (0.70, 0.46, 0.68), 0.45,
    ),
    "suv": Body(
        4.65, 1.90, 1.72,
        ((0, 0.50), (0.008, 0.60), (0.02, 0.64), (0.055, 0.92), (0.09, 0.985), (0.30, 1.0),
         (0.60, 0.98), (0.74, 0.70), (0.93, 0.63), (0.985, 0.55), (1, 0.40)),
        0.62, (0.07, 0.72), (0.72, 0.44, 0.63), 0.42,
    ),
    "van": Body(
        5.2, 1.98, 2.15,
        ((0, 0.40), (0.004, 0.52), (0.008, 0.56), (0.014, 0.90), (0.03, 0.985), (0.12, 1.0),
         (0.70, 0.99), (0.86, 0.62), (0.95, 0.55), (0.985, 0.45), (1, 0.30)),
        0.55, (0.62, 0.84), (0.82, 0.34, 0.56), 0.32,
    ),
    "pickup": Body(
        5.4, 1.95, 1.80,
        ((0, 0.50), (0.006, 0.62), (0.01, 0.66), (0.36, 0.67), (0.40, 0.93), (0.46, 1.0),
         (0.62, 0.98), (0.74, 0.70), (0.93, 0.64), (0.985, 0.55), (1, 0.40)),
        0.64, (0.40, 0.72), (0.80, 0.40, 0.60), 0.36,
    ),
    "bus": Body(
        11.0, 2.5, 3.0,
        ((0, 0.40), (0.002, 0.50), (0.004, 0.54), (0.010, 0.92), (0.02, 0.985), (0.08, 1.0),
         (0.92, 1.0), (0.98, 0.97), (0.99, 0.55), (0.995, 0.45), (1, 0.25)),
        0.50, (0.04, 0.97), (0.84, 0.25, 0.36), 0.25,
    ),
    "truck": Body(
        11.5, 2.5, 3.7,
        ((0, 0.99), (0.002, 1.0), (0.78, 1.0), (0.782, 0.99), (0.79, 0.78), (0.81, 0.80),
         (0.93, 0.80), (0.985, 0.52), (0.995, 0.40), (0.998, 0.30), (1, 0.25)),
        0.52, (0.86, 0.97), (0.70, 0.19, 0.225), 0.205,
    ),
}  # fmt: skip


def _floor(body):
    """Height of the lower edge of the body, in metres."""
    return 0.24 if body.height < 3 else 0.75


def _cross_section(body, z, top):
    """Half outline at a share z of the length: from the floor up to the middle of the roof."""
    half = 0.5 * body.width * (1 - 0.09 * (1 - z / 0.12) ** 2 * (z < 0.12))
    half *= 1 - 0.14 * max(0, (z - 0.86) / 0.14) ** 2
    height = body.height
    floor = _floor(body)
    belt = min(body.belt, top) * height
    top = top * height
    lean = 0.16 * half if body.height < 2 else 0.05 * half
    glass_top = max(belt, top - 0.07)
    rise = (glass_top - belt) / max(0.05, height * (1 - body.belt))
    return np.array(
        [
            (half * 0.93, floor),
            (half * 0.985, floor + 0.14),
            (half, 0.5 * (floor + belt)),
            (half * 0.985, belt - 0.07),
            (half * 0.95, belt),
            (half * 0.95 - lean * rise, glass_top),
            (half * 0.86 - lean * rise, top),
            (half * 0.45, top + 0.015),
            (0.0, top + 0.02),
        ]
    )


@lru_cache(maxsize=8)
def _mesh(kind):
    """Triangles of a vehicle: corners (n, 3, 3), normals (n, 3, 3), materials (n,).

    The origin lies on the ground under the middle of the rear.
    """
    body = BODIES[kind]
    stations = np.array(body.profile)
    sections = np.array([_cross_section(body, z, top) for z, top in stations])
    outline = np.concatenate([sections, sections[:, -2::-1] * (-1, 1)], axis=1)
    z = np.broadcast_to(stations[:, :1] * body.length, outline.shape[:2])
    grid = np.concatenate([outline, z[..., None]], axis=2)
    quads, materials = [], []
    n_half = sections.shape[1]
    for i in range(len(grid) - 1):
        for k in range(grid.shape[1] - 1):
            strip = min(k, 2 * n_half - 3 - k)
            quads.append((grid[i, k], grid[i, k + 1], grid[i + 1, k + 1], grid[i + 1, k]))
            materials.append(_strip_material(body, kind, stations[i : i + 2], strip))
    corners, normals = _smooth_quads(np.array(quads))
    flat, flat_materials = _caps_and_wheels(body, grid)
    flat_normals = np.cross(flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0])
    flat_normals /= np.linalg.norm(flat_normals, axis=1, keepdims=True) + 1e-12
    return (
        np.concatenate([corners, flat]),
        np.concatenate([normals, np.repeat(flat_normals[:, None], 3, axis=1)]),
        np.concatenate([np.repeat(materials, 2), flat_materials]),
    )


def _strip_material(body, kind, stations, strip):
    """Material of the quad between two stations, on a strip of the cross-section."""
    (z0, top0), (z1, top1) = stations
    if kind == "truck" and z1 < 0.783:
        return BOX
    beside = body.cabin[0] <= 0.5 * (z0 + z1) <= body.cabin[1]
    if strip == 4 and beside and min(top0, top1) > body.belt:
        return GLASS
    steep = abs(top1 - top0) > 0.12 and max(top0, top1) > body.belt + 0.15
    return GLASS if strip >= 6 and steep else PAINT


def _smooth_quads(quads):
    """Triangles of quads, normals averaged where quads of similar slant meet."""
    across = np.cross(quads[:, 2] - quads[:, 0], quads[:, 3] - quads[:, 1])
    facing = across / (np.linalg.norm(across, axis=1, keepdims=True) + 1e-9)
    keys = np.round(quads.reshape(-1, 3) * 1e4).astype(int)
    _, vertex = np.unique(keys, axis=0, return_inverse=True)
    vertex = vertex.reshape(-1, 4)
    normals = np.repeat(facing[:, None], 4, axis=1)
    for shared in range(vertex.max() + 1):
        quad, corner = np.nonzero(vertex == shared)
        alike = facing[quad] @ facing[quad].T > 0.55
        normals[quad, corner] = alike @ across[quad]
    normals /= np.linalg.norm(normals, axis=2, keepdims=True) + 1e-9
    triangles = [[0, 1, 2], [0, 2, 3]]
    return (
        quads[:, triangles].reshape(-1, 3, 3),
        normals[:, triangles].reshape(-1, 3, 3),
    )


def _caps_and_wheels(body, grid):
    """Flat parts: rear, front, what is under the floor, wheels."""
    triangles, materials = [], []

    def add(points, material):
        """Add a flat convex polygon as a fan of triangles."""
        points = np.asarray(points, float)
        for i in range(1, len(points) - 1):
            triangles.append(points[[0, i, i + 1]])
            materials.append(material)

    add(grid[0], BOX if body.height > 3 else PAINT)
    add(grid[-1], PAINT)
    half, floor = 0.5 * body.width, grid[0, 0, 1]
    left, right, rear, front = -0.8 * half, 0.8 * half, 0.03 * body.length, 0.97 * body.length
    for z in (rear, front):
        add([(left, 0.2, z), (right, 0.2, z), (right, floor + 0.1, z), (left, floor + 0.1, z)],
            DARK)  # fmt: skip
    for x in (left, right):
        add([(x, 0.2, rear), (x, 0.2, front), (x, floor + 0.1, front), (x, floor + 0.1, rear)],
            DARK)  # fmt: skip
    for x, y, z, radius in _wheels(body):
        angle = np.linspace(0, 2 * np.pi, 19)
        ring = np.stack([0 * angle, y + radius * np.sin(angle), z + radius * np.cos(angle)], 1)
        inner = ring + (x - 0.24 * np.sign(x), 0, 0)
        outer = ring + (x, 0, 0)
        add(outer, RUBBER)
        add(inner, RUBBER)
        for i in range(len(angle) - 1):
            add([inner[i], inner[i + 1], outer[i + 1], outer[i]], RUBBER)
    return np.array(triangles), np.array(materials)


def _wheels(body):
    """Outer centres and radii (x, y, z, radius) of the wheels."""
    radius = 0.325 if body.height < 1.6 else 0.36 if body.height < 2.5 else 0.5
    half = 0.5 * body.width - 0.01
    shares = (0.19, 0.80) if body.height < 3 else (0.10, 0.20, 0.88)
    return [(x, radius, z * body.length, radius) for z in shares for x in (-half, half)]


@dataclass(frozen=True)
class Actor:
    """One vehicle and its way: distance from the camera and place across the road.

    Attributes
    ----------
    identity : int
    kind : str
        Of `BODIES`.
    paint : tuple of float
        RGB, 0..1.
    distance, speed : float
        Rear end ahead of the camera at time 0, in metres, and its change in m/s.
    lane, lane_change : float
        Lane at time 0, and how many lanes it moves over at `change_time`.
    change_time : float
        In seconds.
    oncoming : bool
        On the other carriageway, seen from its front.
    yaw : float
        Heading against that of the camera, in radians: crossing, turning, parked.
    size : float
        Of the kind's own, about 1.
    style : int
        Seed of the details: plate, bumper, lights.
    """

    identity: int
    kind: str
    paint: tuple
    distance: float
    speed: float
    lane: float
    lane_change: float = 0.0
    change_time: float = 0.0
    oncoming: bool = False
    yaw: float = 0.0
    size: float = 1.0
    style: int = 0

    def place(self, time):
        """(distance, lane) at a time in seconds."""
        share = np.clip((time - self.change_time) / 4.0, 0, 1)
        smooth = share * share * (3 - 2 * share)
        return self.distance + self.speed * time, self.lane + self.lane_change * smooth

    def middle(self, time):
        """Distance of its middle at a time in seconds: what is nearer is drawn later."""
        angle = self.yaw + (np.pi if self.oncoming else 0.0)
        return self.place(time)[0] + np.cos(angle) * self.size * BODIES[self.kind].length / 2


# ---------------------------------------------------------------------- road


@dataclass(frozen=True)
class World:
    """Everything that stays the same from frame to frame.

    Attributes
    ----------
    seed : int
        Of noise, trees and textures.
    n_lanes, own_lane : int
        Lanes counted from the left.
    speed : float
        Of the camera, in m/s.
    bend, crest : (amplitude in m, wavelength in m, phase)
    sun : ndarray of float, shape (3,)
        Direction to the sun, unit length.
    haze : float
        0 for none to 1.
    exposure : float
    shade : tuple of (start, length)
        Stretches of the road, in metres, under the shadows of trees.
    pavement : tuple of (start, gray)
        Where a new surface begins, and how light it is.
    grass : tuple of float
        RGB of the verge.
    left_wall : bool
        A concrete wall in the middle, else a guardrail.
    is_town : bool
        Facades along the road instead of guardrails.
    actors : tuple of Actor
    camera : Camera
    """

    seed: int
    n_lanes: int
    own_lane: int
    speed: float
    bend: tuple
    crest: tuple
    sun: np.ndarray
    haze: float
    exposure: float
    shade: tuple
    pavement: tuple
    grass: tuple
    left_wall: bool
    is_town: bool = False
    actors: tuple = ()
    camera: Camera = field(default_factory=Camera)


def make_world(seed, actors=()):
    """A world with road, weather and roadside drawn from a seed."""
    rng = np.random.default_rng([seed, 1])
    n_lanes = int(rng.integers(2, 5))
    azimuth, elevation = rng.uniform(0, 2 * np.pi), rng.uniform(0.5, 1.2)
    starts = np.cumsum(rng.uniform(40, 160, size=14)) - 60
    return World(
        seed=seed,
        n_lanes=n_lanes,
        own_lane=int(rng.integers(0, n_lanes)),
        speed=float(rng.uniform(24, 31)),
        bend=(rng.uniform(2, 14), rng.uniform(450, 900), rng.uniform(0, 6.28)),
        crest=(rng.uniform(0.5, 4), rng.uniform(400, 800), rng.uniform(0, 6.28)),
        sun=np.array(
            [np.cos(azimuth) * np.cos(elevation), np.sin(elevation),
             np.sin(azimuth) * np.cos(elevation)]
        ),
        haze=float(rng.uniform(0.1, 0.7)),
        exposure=float(rng.uniform(0.8, 1.12)),
        shade=tuple((s, rng.uniform(8, 35)) for s in starts[:: rng.integers(1, 3)]),
        pavement=tuple(
            (s, rng.choice([0.25, 0.29, 0.34, 0.55])) for s in (-1e6, *(starts[1::3] + 20))
        ),
        grass=tuple(
            np.array([(0.36, 0.40, 0.20), (0.58, 0.49, 0.30), (0.27, 0.34, 0.16)])[
                rng.integers(3)
            ]
        ),
        left_wall=bool(rng.random() < 0.6),
        actors=tuple(actors),
    )  # fmt: skip


def _wave(curve, s):
    """Value and slope of a sine of (amplitude, wavelength, phase) at s."""
    amplitude, wavelength, phase = curve
    k = 2 * np.pi / wavelength
    return amplitude * np.sin(k * s + phase), amplitude * k * np.cos(k * s + phase)


def _path(curve, s0, z):
    """How far the road has left the tangent at s0 after z metres."""
    start, slope = _wave(curve, s0)
    return _wave(curve, s0 + z)[0] - start - slope * z


@dataclass(frozen=True)
class View:
    """The ideal camera of one frame: where the road lies in the picture.

    Attributes
    ----------
    world : World
    s0 : float
        Place of the camera along the road, in metres.
    size, center : ndarray, shape (2,)
        Of the ideal picture, in pixels: width and height, optical axis.
    lateral : float
        Place of the camera across the road, in metres.
    shake : ndarray of float, shape (2,)
        How far the picture is shaken off its place, in pixels.
    """

    world: World
    s0: float
    size: np.ndarray
    center: np.ndarray
    lateral: float
    shake: np.ndarray

    @classmethod
    def of(cls, world, time):
        """View of a world at a time in seconds."""
        rng = np.random.default_rng([world.seed, 2, round(time * 1000)])
        size, origin, _ = _lens(world.camera)
        shake = rng.normal(size=2) * 0.35 + (0, 1.2 * np.sin(7 * time) + 0.8 * np.sin(11.3 * time))
        lateral = (world.own_lane + 0.5 - world.n_lanes / 2) * LANE_WIDTH
        lateral += 0.25 * np.sin(0.3 * time)
        center = np.array(world.camera.center) - origin + shake + (0, world.camera.horizon_below)
        return cls(world, world.speed * time, size, center, lateral, shake)

    def camera_points(self, x, y, z):
        """Road coordinates to camera coordinates, y down, shape (n, 3)."""
        x = x + _path(self.world.bend, self.s0, z) - self.lateral
        y = self.world.camera.mount_height - y - _path(self.world.crest, self.s0, z)
        return np.stack(np.broadcast_arrays(x, y, z), axis=-1)

    def pixels(self, x, y, z):
        """Road coordinates to pixels of the ideal picture, shape (n, 2)."""
        points = self.camera_points(x, y, z)
        return points[..., :2] * (self.world.camera.focal / points[..., 2:]) + self.center

    def distorted(self, x, y, z):
        """Road coordinates to pixels of the frame as the camera gives it."""
        points = self.camera_points(x, y, z)
        camera = self.world.camera
        down = (self.shake + (0, camera.horizon_below)) / camera.focal
        points[..., :2] += points[..., 2:] * down
        return self.world.camera.project(points)


# -------------------------------------------------------------------- ground


def _visible_ground(view):
    """Distance that each picture row looks at, shape (rows,), infinite for the sky."""
    z = np.geomspace(1.5, _FAR, 3000)
    row = view.pixels(np.zeros_like(z), np.zeros_like(z), z)[:, 1]
    lowest = np.minimum.accumulate(row)
    seen = np.concatenate([[True], lowest[1:] < lowest[:-1]])
    rows = np.arange(view.size[1])
    distance = np.interp(rows, row[seen][::-1], z[seen][::-1], left=np.inf)
    distance[rows < row[seen].min()] = np.inf
    return distance


def _stripes(x, middle, width, footprint):
    """Share of a pixel that a line of paint along the road covers."""
    overlap = (0.5 * (width + footprint) - np.abs(x - middle)) / footprint
    return np.clip(overlap, 0, np.minimum(1, width / footprint))


def _dashes(s, length, period, footprint):
    """Share of a pixel's length that dashes along the road cover."""

    def covered(s):
        """Metres of paint from the start of the road to s."""
        return np.floor(s / period) * length + np.minimum(s % period, length)

    return (covered(s + footprint / 2) - covered(s - footprint / 2)) / footprint


def _draw_ground(view, picture, distance, first):
    """Road, markings, kerb, verge and the shadows of trees on all of it.

    `distance` is that of `_visible_ground`, `first` the first row it is finite in.
    """
    world = view.world
    z = distance[first:, None]
    footprint_z = np.abs(np.gradient(distance[first:]))[:, None] + 1e-3
    footprint_x = z / world.camera.focal
    columns = np.arange(view.size[0])[None]
    x = (columns - view.center[0]) * footprint_x
    x = (x + view.lateral - _path(world.bend, view.s0, z)).astype(np.float32)
    s = (view.s0 + z).astype(np.float32)
    footprint_x, footprint_z = footprint_x.astype(np.float32), footprint_z.astype(np.float32)

    edge = world.n_lanes * LANE_WIDTH / 2
    fine = np.clip(1.5 - footprint_z / 0.5, 0, 1)
    grain = _noise(world.seed, x, s, 7.0) * fine
    blotch = _noise(world.seed + 1, x * 2, s, 90.0)
    gray = np.zeros(s.shape, np.float32)
    for start, level in world.pavement:
        gray[s > start] = level
    wheel_tracks = np.cos(2 * np.pi * (x + edge) / (LANE_WIDTH / 2)) * 0.012
    gray = gray + 0.018 * grain + 0.022 * blotch + wheel_tracks
    color = gray[..., None] * np.float32([1.0, 1.0, 1.02])

    markings = np.zeros(x.shape, np.float32)
    for lane in range(1, world.n_lanes):
        line = _stripes(x, lane * LANE_WIDTH - edge, 0.14, footprint_x)
        markings = np.maximum(markings, line * _dashes(s, 4.0, 12.0, footprint_z))
    markings = np.maximum(markings, _stripes(x, edge, 0.16, footprint_x))
    wear = np.clip(0.85 + 0.12 * grain, 0, 1)
    color = _blend(color, (0.88, 0.88, 0.86), markings * wear)
    color = _blend(color, (0.85, 0.66, 0.15), _stripes(x, -edge, 0.16, footprint_x) * wear)

    verge = np.float32(world.grass) * (1 + 0.16 * _noise(world.seed + 2, x, s, 23.0))[..., None]
    verge *= (1 + 0.15 * grain)[..., None]
    color = _blend(color, verge, np.clip((x - edge - 2.6) / 0.12, 0, 1))
    color = _blend(color, verge, np.clip((-x - edge - 2.0) / 0.12, 0, 1))
    kerb = _stripes(x, edge + 2.5, 0.22, footprint_x)
    color = _blend(color, (0.62, 0.61, 0.58), kerb)
    color = _blend(color, (0.12, 0.12, 0.12), _stripes(x, edge + 2.36, 0.07, footprint_x))

    picture[first:] = color * (1 - 0.58 * _tree_shadow(world, x, s))[..., None]


def _blend(color, other, share):
    """Colours (..., 3) with a share (...) of another colour mixed in, float32."""
    shape = (*np.shape(share), 3)
    color = np.broadcast_to(np.asarray(color, np.float32), shape)
    other = np.broadcast_to(np.asarray(other, np.float32), shape)
    return _mix(color, other, np.asarray(share, np.float32))


@compiled()
def _mix(color, other, share):
    mixed = np.empty(color.shape, np.float32)
    for row in range(color.shape[0]):
        for column in range(color.shape[1]):
            for c in range(3):
                start = color[row, column, c]
                mixed[row, column, c] = start + share[row, column] * (other[row, column, c] - start)
    return mixed


def _tree_shadow(world, x, s):
    """0 in the sun to 1 in the shadow of leaves, with ragged edges."""
    depth = np.zeros(s.shape, np.float32)
    for start, length in world.shade:
        middle = start + length / 2
        depth = np.maximum(depth, 1.4 - np.abs(s - middle) / (length / 2))
    lean = x * 0.8
    leaves = _noise(world.seed + 3, x + lean, s, 31.0) + 0.6 * _noise(
        world.seed + 4, x, s + lean, 9.0
    )
    return 1 / (1 + np.exp(-5 * (leaves - 0.9 + 1.8 * depth - 1.0)))


# ----------------------------------------------------------- sky and roadside


def _draw_sky(view, picture, horizon):
    """Sky, clouds, hills and the line of far trees, all above a row."""
    world = view.world
    horizon = min(horizon + 3, picture.shape[0])
    # Nothing up there is sharp: half the resolution is enough.
    columns, rows = np.meshgrid(
        np.arange(0, view.size[0], 2, dtype=np.float32), np.arange(0, horizon, 2, dtype=np.float32)
    )
    up = (view.center[1] - rows) / view.center[1]
    zenith = np.clip(up * 1.5, 0, 1) ** 0.7
    color = _blend((0.80, 0.87, 0.93), (0.27, 0.48, 0.78), zenith)
    heading = np.arctan(_wave(world.bend, view.s0)[1])
    turn = columns + np.float32(world.camera.focal * heading)
    clouds = _noise(world.seed + 5, turn, rows * 3.5, 2600.0)
    color = _blend(color, (0.95, 0.95, 0.96), np.clip(clouds * 0.5 - 0.2, 0, 0.8))
    ridges = (
        (46, 2100.0, (0.36, 0.45, 0.56)), (26, 1300.0, (0.30, 0.38, 0.34)),
        (13, 500.0, (0.16, 0.20, 0.12)),
    )  # fmt: skip
    rough = _noise(world.seed + 9, turn, rows * 2, 180.0)
    for i, (height, period, shade) in enumerate(ridges):
        ridge = _noise(world.seed + 6 + i, turn[:1], np.float32([[17]]), period)
        top = view.center[1] - height * (1 + 0.55 * ridge)
        shaded = np.float32(shade) * (1 + 0.22 * rough * (i + 1) / 3)[..., None]
        haze = np.full(rows.shape, world.haze * (0.75, 0.4, 0.15)[i])
        shaded = _blend(shaded, (0.72, 0.79, 0.86), haze)
        color = _blend(color, shaded, np.clip(rows - top + 0.5, 0, 1))
    picture[:horizon] = cv2.resize(color, (picture.shape[1], horizon))


@lru_cache(maxsize=4)
def _tree_sprites(seed, count=6, size=256):
    """Trees as RGBA pictures, float32, 0..1."""
    rng = np.random.default_rng([seed, 3])
    y, x = np.mgrid[:size, :size].astype(np.float32) / size
    sprites = []
    for i in range(count):
        crown = np.full((size, size), -1, np.float32)
        for _ in range(rng.integers(9, 16)):
            cx, cy = rng.normal(0.5, 0.11), rng.uniform(0.2, 0.62)
            radius = rng.uniform(0.08, 0.17)
            crown = np.maximum(crown, 1.2 - np.hypot(x - cx, (y - cy) * 1.1) / radius)
        leaves = _noise(seed + 20 + i, x, y, 0.9) * 0.16 + _noise(seed + 21, x, y, 0.3) * 0.12
        alpha = np.clip((crown + leaves - 0.12) * 5, 0, 1)
        trunk = (np.abs(x - 0.5 - 0.02 * np.sin(9 * y)) < 0.018 * (0.5 + y)) & (y > 0.45)
        alpha = np.maximum(alpha, trunk * 0.95)
        alpha[y > 0.995] = 0
        light = 0.5 + 0.35 * (crown > 0.3) * (0.75 - y) + 0.18 * leaves
        base = np.array([(0.30, 0.36, 0.18), (0.22, 0.29, 0.15), (0.38, 0.36, 0.22)])[i % 3]
        rgb = np.clip(base * light[..., None] * 1.6, 0, 1)
        rgb[trunk & (crown + leaves < 0.5)] = (0.24, 0.19, 0.15)
        sprites.append(np.dstack([rgb, alpha]).astype(np.float32))
    return sprites


def _roadside_things(view):
    """Trees, lamp posts and signs as (distance, drawing function, its arguments)."""
    world = view.world
    edge = world.n_lanes * LANE_WIDTH / 2
    things = []
    first = int(view.s0 // 9) - 1
    for i in range(first, first + 40):
        rng = np.random.default_rng([world.seed, 4, i + 1000])
        z = i * 9 + rng.uniform(0, 9) - view.s0
        side = 1 if rng.random() < 0.6 else -1
        away = rng.uniform(6, 32) if side > 0 else rng.uniform(16, 45)
        sort, height, sprite = rng.random(), rng.uniform(4, 12), int(rng.integers(6))
        if not 6 < z < 330:
            continue
        x = side * (edge + away)
        if sort < 0.75:
            things.append((z, _draw_tree, (x, z, height, sprite)))
        elif sort < 0.85:
            things.append((z, _draw_post, (side * (edge + 4.2), z, 9.0)))
        elif sort < 0.9 and side > 0:
            things.append((z, _draw_sign, (edge + 5.0, z, int(rng.integers(3)))))
    return things


@lru_cache(maxsize=2)
def _facade_sprites(seed, count=4, size=256):
    """Walls with rows of windows and a ground floor of shops, RGBA."""
    rng = np.random.default_rng([seed, 7])
    sprites = []
    for _ in range(count):
        wall = np.array((0.45, 0.42, 0.4)) + rng.uniform(-0.2, 0.25) + rng.normal(0, 0.05, 3)
        sprite = np.empty((size, size, 4), np.float32)
        sprite[..., :3] = wall + rng.normal(0, 0.02, (size, size, 1))
        sprite[..., 3] = 1
        floors, columns = rng.integers(2, 6), rng.integers(3, 9)
        height, width = size / (floors + 1), size / columns
        for floor in range(floors + 1):
            for column in range(columns):
                top, left = (floor + 0.25) * height, (column + 0.2) * width
                glass = rng.uniform(0.05, 0.35) + np.array((0.0, 0.02, 0.05))
                share = 0.75 if floor == floors else 0.5
                bottom, right = int(top + share * height), int(left + 0.6 * width)
                cv2.rectangle(sprite, (int(left), int(top)), (right, bottom), (*wall * 1.3, 1), 3)
                sprite[int(top) : bottom, int(left) : right, :3] = glass
        sprites.append(np.clip(sprite, 0, 1))
    return sprites


def _facades(view):
    """Houses on both sides as (distance, drawing function, its arguments)."""
    world, things = view.world, []
    for side in (-1, 1):
        rng, z = np.random.default_rng([world.seed, 8, side + 1]), 4.0
        x = side * (world.n_lanes * LANE_WIDTH / 2 + rng.uniform(5, 10))
        while z < 160:
            length, height = rng.uniform(8, 25), rng.uniform(5, 20)
            things.append((z + length, _draw_facade, ((x, z, length, height, rng.integers(4)),)))
            z += length + rng.choice([0.2, 6.0])
    return things


def _draw_facade(view, picture, place):
    """A wall along the road, in perspective; place is x, z, length, height and its sprite."""
    x, z, length, height, sprite = place
    wall = _facade_sprites(view.world.seed)[sprite]
    corners = view.pixels(
        np.full(4, x), np.array([height, height, 0, 0]), np.array([z, z + length, z + length, z])
    ).astype(np.float32)
    left, top = np.maximum(np.floor(corners.min(axis=0)), 0).astype(int)
    right, bottom = np.minimum(np.ceil(corners.max(axis=0)), view.size).astype(int)
    if right <= left or bottom <= top:
        return
    side = float(wall.shape[0])
    source = np.float32([(0, 0), (side, 0), (side, side), (0, side)])
    matrix = cv2.getPerspectiveTransform(source, corners - np.float32([left, top]))
    placed = cv2.warpPerspective(wall, matrix, (int(right - left), int(bottom - top)))
    region = picture[top:bottom, left:right]
    haze = view.world.haze * z / 700
    color = placed[..., :3] + haze * (_HAZE - placed[..., :3])
    picture[top:bottom, left:right] = region + placed[..., 3:] * (color - region)


def _draw_tree(view, picture, x, z, height, sprite):
    (column, row), (_, top) = view.pixels(
        np.array([x, x]), np.array([-0.3, height]), np.array([z, z])
    )
    size = row - top
    tree = _tree_sprites(view.world.seed)[sprite]
    if size < 4:
        return
    scale = size / tree.shape[0]
    matrix = np.array([[scale, 0, column - size / 2], [0, scale, top]])
    _paste(picture, tree, matrix, view.world.haze * z / 700)


def _paste(picture, sprite, matrix, haze):
    """Draw an RGBA sprite into the picture, placed by an affine matrix."""
    height, width = picture.shape[:2]
    corners = matrix @ [[0, sprite.shape[1]], [0, sprite.shape[0]], [1, 1]]
    left, top = np.maximum(np.floor(corners[:, 0]), 0).astype(int)
    right, bottom = np.minimum(np.ceil(corners[:, 1]), (width, height)).astype(int)
    if right <= left or bottom <= top:
        return
    scale = matrix[0, 0]
    if scale < 1:
        size = max(1, round(sprite.shape[1] * scale)), max(1, round(sprite.shape[0] * scale))
        sprite = cv2.resize(sprite, size, interpolation=cv2.INTER_AREA)
        matrix = np.array([[1, 0, matrix[0, 2]], [0, 1, matrix[1, 2]]])
    shifted = matrix - [[0, 0, left], [0, 0, top]]
    placed = cv2.warpAffine(sprite, shifted, (right - left, bottom - top))
    region = picture[top:bottom, left:right]
    color = placed[..., :3] + haze * (_HAZE - placed[..., :3])
    picture[top:bottom, left:right] = region + placed[..., 3:] * (color - region)


def _fill(picture, pixels, color):
    """Fill a polygon given in pixels, edges smoothed."""
    if np.abs(pixels).max() < 8000:
        fixed = np.round(pixels * 16).astype(np.int32)
        cv2.fillPoly(picture, [fixed], tuple(float(c) for c in color), cv2.LINE_AA, 4)


def _draw_post(view, picture, x, z, height):
    inwards = -np.sign(x)
    for x0, x1, y0, y1 in (
        (x - 0.09, x + 0.09, 0, height), (x, x + inwards * 2.2, height - 0.12, height),
    ):  # fmt: skip
        pixels = view.pixels(
            np.array([x0, x1, x1, x0]), np.array([y0, y0, y1, y1]), np.full(4, float(z))
        )
        _fill(picture, pixels, (0.42, 0.43, 0.44))


def _draw_sign(view, picture, x, z, sort):
    color = ((0.05, 0.33, 0.20), (0.08, 0.20, 0.45), (0.62, 0.61, 0.58))[sort]
    for left, right, bottom, top, shade in (
        (x - 0.9, x - 0.8, 0, 2.4, (0.4, 0.4, 0.4)), (x + 0.8, x + 0.9, 0, 2.4, (0.4, 0.4, 0.4)),
        (x - 1.5, x + 1.5, 2.2, 4.2, (0.9, 0.9, 0.9)), (x - 1.43, x + 1.43, 2.27, 4.13, color),
        (x - 1.1, x + 0.7, 3.4, 3.65, (0.9, 0.9, 0.9)),
        (x - 1.1, x + 0.2, 2.8, 3.05, (0.9, 0.9, 0.9)),
    ):  # fmt: skip
        pixels = view.pixels(
            np.array([left, right, right, left]), np.array([bottom, bottom, top, top]),
            np.full(4, float(z)),
        )  # fmt: skip
        _fill(picture, pixels, shade)


def _draw_rails(view, picture):
    """Wall or rail in the middle, guardrail with posts on the right, far parts first."""
    world = view.world
    edge = world.n_lanes * LANE_WIDTH / 2
    for z in np.arange(int(110 / 4) * 4, 3, -4.0) - view.s0 % 4:
        for x in (edge + 3.0, *(() if world.left_wall else (-edge - 1.6,))):
            _draw_strip(view, picture, x, np.array([z, z + 0.15]), (0, 0.7), (0.33, 0.33, 0.32))
    stations = np.geomspace(3.2, 300, 70)
    for near, far in zip(stations[-2::-1], stations[:0:-1], strict=True):
        z = np.array([near, far])
        rough = (
            1
            + 0.08
            * _noise(world.seed + 8, np.float32([[near + view.s0]]), np.float32([[3]]), 40.0)[0, 0]
        )
        sides = [edge + 3.0]
        if world.left_wall:
            wall = np.array((0.50, 0.49, 0.46)) * rough * (0.8 + 0.4 * (world.sun[0] > 0))
            for low, high, shade in ((0, 0.35, 0.8), (0.34, 0.85, 1.0), (0.83, 0.9, 1.25)):
                _draw_strip(view, picture, -edge - 1.45, z, (low, high), wall * shade)
        else:
            sides.append(-edge - 1.6)
        for x in sides:
            steel = np.array((0.58, 0.60, 0.61)) * rough
            for low, high, shade in (
                (0.45, 0.52, 0.75), (0.52, 0.57, 1.1), (0.57, 0.62, 0.6),
                (0.62, 0.68, 0.85), (0.68, 0.76, 1.25),
            ):  # fmt: skip
                _draw_strip(view, picture, x, z, (low, high), steel * shade)


def _draw_strip(view, picture, x, z, heights, color):
    """A quad along the road, between two distances and two heights."""
    low, high = heights
    pixels = view.pixels(
        np.full(4, float(x)), np.array([low, low, high, high]), np.array([*z, *z[::-1]])
    )
    _fill(picture, pixels, color)


# ---------------------------------------------------------- drawing vehicles


@compiled()
def _rasterise(screen, inverse_depth, attributes, materials, canvas):
    """Nearest triangle of every pixel, attributes interpolated in perspective.

    screen (n, 3, 2), inverse_depth (n, 3), attributes (n, 3, 6), materials
    (n,); canvas is depth (rows, columns), which starts at 0 and keeps the
    largest inverse, surface (rows, columns, 6) and material (rows, columns).
    """
    depth, surface, material = canvas
    rows, columns = depth.shape
    for t in range(screen.shape[0]):
        ax, ay = screen[t, 0]
        bx, by = screen[t, 1]
        cx, cy = screen[t, 2]
        area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if abs(area) < 1e-9:
            continue
        left = max(0, int(np.floor(min(ax, bx, cx))))
        right = min(columns - 1, int(np.ceil(max(ax, bx, cx))))
        top = max(0, int(np.floor(min(ay, by, cy))))
        bottom = min(rows - 1, int(np.ceil(max(ay, by, cy))))
        for row in range(top, bottom + 1):
            for column in range(left, right + 1):
                x = column + 0.5
                y = row + 0.5
                b = ((x - ax) * (cy - ay) - (y - ay) * (cx - ax)) / area
                c = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / area
                a = 1.0 - b - c
                if a < 0 or b < 0 or c < 0:
                    continue
                a *= inverse_depth[t, 0]
                b *= inverse_depth[t, 1]
                c *= inverse_depth[t, 2]
                total = a + b + c
                if total <= depth[row, column]:
                    continue
                depth[row, column] = total
                material[row, column] = materials[t]
                for k in range(6):
                    surface[row, column, k] = (
                        a * attributes[t, 0, k] + b * attributes[t, 1, k] + c * attributes[t, 2, k]
                    ) / total


def _actor_mesh(view, actor, time):
    """Triangles of an actor in road coordinates, normals turned alike, own coordinates."""
    distance, lane = actor.place(time)
    corners, normals, materials = _mesh(actor.kind)
    x = (lane + 0.5 - view.world.n_lanes / 2) * LANE_WIDTH
    slope = _wave(view.world.bend, view.s0 + distance)[1] - _wave(view.world.bend, view.s0)[1]
    drift = LANE_WIDTH * (actor.place(time + 0.05)[1] - lane) / 0.05 / view.world.speed
    angle = np.arctan(drift) + actor.yaw + (np.pi if actor.oncoming else 0.0)
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])
    placed = (corners * actor.size) @ turn + (x, 0, distance)
    heading = np.arctan(slope)
    cos, sin = np.cos(heading), np.sin(heading)
    facing = normals @ turn @ np.array([[cos, 0, -sin], [0, 1, 0], [sin, 0, cos]])
    return placed, facing, corners, materials


def _draw_actor(view, picture, actor, time):
    """Draw one vehicle.

    Returns
    -------
    coverage : (left, top, ndarray of float32), or None if nothing is to be seen
        How much of each pixel it covers, and where in the picture that is.
    box : ndarray of float, shape (4,), or None
        In pixels of the frame.
    """
    placed, facing, own, materials = _actor_mesh(view, actor, time)
    seen = placed[:, :, 2].min(axis=1) > 1.0
    placed, facing, own, materials = placed[seen], facing[seen], own[seen], materials[seen]
    if not len(placed):
        return None, None
    x, y, z = placed.reshape(-1, 3).T
    pixels = view.pixels(x, y, z)
    left, top = np.maximum(np.floor(pixels.min(axis=0)) - 1, 0).astype(int)
    right, bottom = np.minimum(np.ceil(pixels.max(axis=0)) + 1, view.size).astype(int)
    if right - left < 2 or bottom - top < 2:
        return None, None
    mesh = placed, facing, own, materials
    sprite = _actor_sprite(view, actor, mesh, pixels, (left, top, right, bottom))
    if not sprite[..., 3].any():
        return None, None
    alpha = sprite[..., 3:]
    haze = view.world.haze * min(1, z.mean() / 600)
    rgb = sprite[..., :3] * (1 - haze) + alpha * haze * _HAZE
    region = picture[top:bottom, left:right]
    picture[top:bottom, left:right] = region * (1 - alpha) + rgb
    outline = view.distorted(x, y, z)
    return (left, top, alpha[..., 0]), np.concatenate([outline.min(axis=0), outline.max(axis=0)])


def _actor_sprite(view, actor, mesh, pixels, place):
    """Shaded picture of a vehicle, RGB times alpha and alpha, float32, as large as its place.

    `mesh` is that of `_actor_mesh`, `pixels` where its corners lie, and `place`
    the box (left, top, right, bottom) of the picture that is drawn.
    """
    placed, facing, own, materials = mesh
    left, top, right, bottom = place
    # Small vehicles are drawn larger and shrunk, or they would flicker.
    fineness = 1 + sum(bottom - top < height for height in (170, 90, 40))
    shape = ((bottom - top) * fineness, (right - left) * fineness)
    surface, material = np.zeros((*shape, 6), np.float32), np.full(shape, -1)
    _rasterise(
        ((pixels - (left, top)) * fineness).reshape(-1, 3, 2),
        1 / placed[..., 2],
        np.concatenate([own, facing], axis=2),
        materials,
        (np.zeros(shape), surface, material),
    )
    hit = material >= 0
    sprite = np.zeros((*shape, 4), np.float32)
    if hit.any():
        middle = placed.reshape(-1, 3).mean(axis=0) - (
            view.lateral,
            view.world.camera.mount_height,
            0,
        )
        middle = middle.astype(np.float32)
        sprite[hit, :3] = _shade(view.world, actor, material[hit], surface[hit], middle)
        sprite[hit, 3] = 1
    return cv2.resize(sprite, (right - left, bottom - top), interpolation=cv2.INTER_AREA)


def _environment(direction):
    """What a shiny surface mirrors: sky, a dark line of trees, road."""
    colors = np.float32(
        [(0.27, 0.27, 0.28), (0.20, 0.23, 0.17), (0.80, 0.86, 0.92), (0.42, 0.58, 0.82)]
    )
    return colors[np.digitize(direction[:, 1], (-0.02, 0.07, 0.35))]


def _shade(world, actor, material, surface, direction):
    """Colour of surface points: own coordinates and normals, shape (n, 6), to RGB (n, 3)."""
    own, normal = surface[:, :3], surface[:, 3:]
    normal = normal / (np.linalg.norm(normal, axis=1, keepdims=True) + 1e-9)
    look = direction / np.linalg.norm(direction)
    towards = normal @ look
    normal = np.where(towards[:, None] > 0, -normal, normal)
    facing = np.abs(towards)
    mirrored = look + 2 * facing[:, None] * normal
    base, gloss = _surface_colors(actor, material, own, normal)
    sky = 0.5 + 0.22 * normal[:, 1:2]
    light = sky + 0.62 * np.clip(normal @ world.sun.astype(np.float32), 0, None)[:, None]
    fresnel = (gloss + (0.9 - gloss) * (1 - facing) ** 5 * (gloss > 0.02))[:, None]
    color = base * light * (1 - fresnel) + _environment(mirrored) * fresnel
    # Rear lights glow a little, in shadow too.
    glowing = (base[:, 0] > 0.5) & (base[:, 1] < 0.1)
    return np.where(glowing[:, None], np.maximum(color, base * 0.75), color)


def _surface_colors(actor, material, own, normal):
    """Base colour (n, 3) and mirror share (n,) of points on a vehicle, details painted on."""
    base = np.array(
        [actor.paint, (0.035, 0.04, 0.045), (0.035, 0.035, 0.04), (0.03, 0.03, 0.03),
         actor.paint], np.float32
    )[material]  # fmt: skip
    gloss = np.float32([0.09, 0.16, 0.0, 0.0, 0.03])[material]
    points = _Points(BODIES[actor.kind], material, own, normal)
    rng = np.random.default_rng([actor.style, 5])
    for details in (_trim, _lamps_and_plate, _wheels_and_arches):
        for where, color, shine in details(points, actor, rng):
            base[where] = color
            gloss[where] = shine
    return base, gloss


class _Points:
    """Points on the surface of a vehicle, and what is asked of them over and over."""

    def __init__(self, body, material, own, normal):
        self.body, self.material, self.normal = body, material, normal
        self.across, self.y, self.z = own.T
        self.x = np.abs(self.across)
        self.half, self.height = body.width / 2, body.height
        self.paint = material == PAINT
        self.solid = self.paint | (material == BOX)
        self.beside = np.abs(normal[:, 0]) > 0.5


def _trim(p, actor, rng):
    """Yield (points, colour, mirror share) of bumpers, seams and handles."""
    black = (0.05, 0.05, 0.05)
    if actor.kind == "truck":
        yield (p.material == BOX) & (p.y < 0.32 * p.height), (0.07, 0.07, 0.08), 0.0
        door = (p.x < 0.012) & (p.z < 0.1) & (p.y > 0.32 * p.height)
        yield (p.material == BOX) & door, (0.25, 0.25, 0.25), 0.0
        return
    low = _floor(p.body) + 0.06 + rng.choice([0.0, 0.05, 0.13]) * (p.z < 0.25)
    yield p.paint & (p.y < low), (0.09, 0.09, 0.10), 0.02
    boot = np.abs(p.y - p.body.plate * p.height * 0.86) < 0.007
    yield p.paint & boot & (p.z < 0.2), black, 0.0
    seams = np.array([0.36, 0.56, 0.74]) * p.body.length
    close = _to_nearest(p.z, seams) < 0.011
    yield p.paint & p.beside & close & (p.y > _floor(p.body) + 0.1), black, 0.0
    handle = _to_nearest(p.z, seams[:2] + 0.12) < 0.09
    level = np.abs(p.y - 0.60 * p.height) < 0.018
    yield p.paint & p.beside & handle & level, (0.12, 0.12, 0.12), 0.1
    if actor.kind == "van":
        yield (p.x < 0.012) & (p.z < 0.2) & (p.y > 0.2 * p.height), black, 0.0


def _to_nearest(values, places):
    """Distance of each value to the nearest of some places."""
    return np.min([np.abs(values - place) for place in places], axis=0)


def _lamps_and_plate(p, actor, rng):
    """Yield (points, colour, mirror share) of lamps, grille and number plate."""
    inner, low, high = p.body.lights
    inner += rng.uniform(-0.06, 0.06)
    share = p.y / p.height
    lamp = (p.x > inner * p.half) & (share > low) & (share < high) & (p.z < 0.22)
    yield p.solid & lamp, (0.62, 0.035, 0.045), 0.10
    clear = (share < low + 0.3 * (high - low)) & (p.x < (inner + 0.18) * p.half)
    yield p.solid & lamp & clear, (0.75, 0.70, 0.66), 0.10
    front = p.paint & (p.z > 0.93 * p.body.length)
    headlamp = (p.x > 0.55 * p.half) & (share > 0.38) & (share < 0.52)
    yield front & headlamp, (0.85, 0.87, 0.9), 0.2
    grille = (p.x < 0.5 * p.half) & (share > 0.25) & (share < 0.46)
    yield front & grille, (0.06, 0.06, 0.07), 0.05
    height = np.abs(p.y - p.body.plate * p.height)
    plate = p.solid & (p.x < 0.26) & (height < 0.06) & (p.z < 0.3)
    yield plate, rng.choice([(0.86, 0.86, 0.84), (0.83, 0.74, 0.30)]), 0.0
    letters = (p.x < 0.21) & (height < 0.033) & (np.floor(p.across / 0.035) % 2 == 0)
    yield plate & letters, (0.15, 0.15, 0.2), 0.0


def _wheels_and_arches(p, actor, rng):
    """Yield (points, colour, mirror share) of arches and rims."""
    for x, y, z, radius in _wheels(p.body):
        away = np.hypot(p.y - y, p.z - z)
        arch = p.beside & (away < radius + 0.07)
        yield p.paint & arch, (0.03, 0.03, 0.03), 0.0
        spoke = np.cos(5 * np.arctan2(p.y - y, p.z - z)) > -0.3
        rim = (away < 0.62 * radius) & (p.across * np.sign(x) > p.half - 0.05)
        hub = away < 0.2 * radius
        yield (p.material == RUBBER) & rim & (spoke | hub), (0.5, 0.51, 0.53), 0.1


def _draw_contact_shadow(view, picture, actor, time):
    """The dark ground under a vehicle, and its shadow from the sun."""
    distance, lane = actor.place(time)
    body = BODIES[actor.kind]
    if distance < 2.5 or distance > 200 or actor.oncoming:
        return
    x = (lane + 0.5 - view.world.n_lanes / 2) * LANE_WIDTH
    half, sun = 0.5 * body.width, view.world.sun
    height = 0.8 * body.height
    reach = -height * sun[0] / sun[1], -height * sun[2] / sun[1]
    cos, sin = np.cos(actor.yaw), np.sin(actor.yaw)
    flat = [(i * half, k * body.length) for k in (0, 1) for i in (-1, 1)]
    corners = [(x + a * cos + b * sin, distance + b * cos - a * sin) for a, b in flat]
    cast = np.array(corners + [(a + reach[0], b + reach[1]) for a, b in corners])
    under = np.array(corners) + [(-0.1, -0.15), (0.1, -0.15), (-0.1, 0.1), (0.1, 0.1)]
    for points, dark in ((cast, 0.5), (under, 0.65)):
        points[:, 1] = np.maximum(points[:, 1], 1.6)
        pixels = view.pixels(points[:, 0], np.zeros(len(points)), points[:, 1])
        if np.abs(pixels).max() > 8000:
            continue
        mask = np.zeros(picture.shape[:2], np.float32)
        hull = cv2.convexHull(np.round(pixels * 16).astype(np.int32))
        cv2.fillConvexPoly(mask, hull, dark, cv2.LINE_AA, 4)
        left, top, width, rows = cv2.boundingRect(np.round(pixels).astype(np.int32))
        soft = max(1, int(12 / distance * 6)) * 2 + 1
        area = (slice(max(0, top - soft), max(0, top + rows + soft)),
                slice(max(0, left - soft), max(0, left + width + soft)))  # fmt: skip
        if mask[area].size:
            picture[area] *= 1 - cv2.GaussianBlur(mask[area], (soft, soft), 0)[..., None]


# --------------------------------------------------------------------- frame


@dataclass(frozen=True)
class TruthBox:
    """One vehicle of a frame.

    Attributes
    ----------
    identity : int
    box : tuple of float
        left, top, right, bottom in pixels of the frame: of all of the vehicle that lies
        within the frame, also of what nearer ones hide.
    required : bool
        In the own carriageway, at least 30 px high, at least half visible.
    visible : float
        Share of the whole vehicle that is in the frame and not hidden.
    distance : float
        Metres along the road from the camera to its nearest point.
    """

    identity: int
    box: tuple
    required: bool
    visible: float
    distance: float


def render(world, time):
    """One frame of a world.

    Parameters
    ----------
    world : World
    time : float
        In seconds.

    Returns
    -------
    frame : ndarray of uint8, shape (height, width, 3)
        RGB.
    truth : list of TruthBox
    """
    view = View.of(world, time)
    picture = np.zeros((view.size[1], view.size[0], 3), np.float32)
    distance = _visible_ground(view)
    first = int(np.argmax(np.isfinite(distance)))
    _draw_sky(view, picture, first)
    _draw_ground(view, picture, distance, first)
    for actor in world.actors:
        _draw_contact_shadow(view, picture, actor, time)
    things = _roadside_things(view)
    things += _facades(view) if world.is_town else []
    things += [(a.middle(time), _draw_actor, (a, time)) for a in world.actors]
    things.sort(key=lambda thing: -thing[0])
    near = [thing for thing in things if thing[1] is _draw_actor and not thing[2][0].oncoming]
    for _, draw, arguments in (thing for thing in things if thing not in near):
        draw(view, picture, *arguments)
    if not world.is_town:
        _draw_rails(view, picture)
    drawn = [(arguments[0], *draw(view, picture, *arguments)) for _, draw, arguments in near]
    oncoming = [(a, _outline(view, a, time)) for a in world.actors if a.oncoming]
    truth = _truth_boxes(view, drawn, time) + _ignored_boxes(view, oncoming, time)
    return _sensor(world, picture, time), truth


def _outline(view, actor, time):
    """Box of an actor in the frame, not cut at its border; None if it is behind the camera."""
    placed = _actor_mesh(view, actor, time)[0].reshape(-1, 3)
    placed = placed[placed[:, 2] > 1.0]
    if not len(placed):
        return None
    outline = view.distorted(*placed.T)
    return np.concatenate([outline.min(axis=0), outline.max(axis=0)])


def _cut(world, box):
    """A box cut at the frame's border, and the share of its area that is left."""
    size = (world.camera.width, world.camera.height) * 2
    inside = np.clip(box, 0, size)
    whole = (box[2] - box[0]) * (box[3] - box[1])
    left = max(0, inside[2] - inside[0]) * max(0, inside[3] - inside[1])
    return inside, left / max(whole, 1e-9)


def _nearest(view, actor, time):
    """Metres along the road to the nearest point of an actor."""
    return float(_actor_mesh(view, actor, time)[0][..., 2].min())


def _truth_boxes(view, drawn, time):
    """Truth of the own carriageway, from (actor, coverage, box), far ones first."""
    truth = []
    for i, (actor, coverage, box) in enumerate(drawn):
        if box is None:
            continue
        inside, share = _cut(view.world, box)
        if share < 1:
            inside = np.clip(inside, *_extent(view, coverage))
        if share < 0.02 or not (inside[:2] < inside[2:]).all():
            continue
        visible = float(share) * _free_share(coverage, [nearer for _, nearer, _ in drawn[i + 1 :]])
        required = bool(visible >= 0.5 and inside[3] - inside[1] >= 30)
        distance = _nearest(view, actor, time)
        box = tuple(inside.tolist())
        truth.append(TruthBox(actor.identity, box, required, visible, distance))
    return truth


def _extent(view, coverage):
    """Least and largest edges of a box around what lies within the frame of a vehicle.

    What the border cuts off of it is nearer, and reaches farther up and down, than the rest.
    """
    left, top, alpha = coverage
    picture = np.zeros(view.size[::-1], np.float32)
    picture[top : top + alpha.shape[0], left : left + alpha.shape[1]] = alpha
    covered = through_lens(view.world.camera, picture) > 0.5
    left, top, columns, rows = cv2.boundingRect(covered.astype(np.uint8))
    return (left, top) * 2, (left + columns, top + rows) * 2


def _free_share(coverage, nearer_ones):
    """How much of a coverage nearer coverages leave to be seen, 0..1."""
    left, top, alpha = coverage
    rows, columns = alpha.shape
    free = alpha.copy()
    for nearer in nearer_ones:
        if nearer is None:
            continue
        x, y, other = nearer
        first_row, last_row = max(0, y - top), min(rows, y - top + other.shape[0])
        first, last = max(0, x - left), min(columns, x - left + other.shape[1])
        if first_row < last_row and first < last:
            hiding = other[
                first_row + top - y : last_row + top - y, first + left - x : last + left - x
            ]
            free[first_row:last_row, first:last] *= 1 - hiding
    return float(free.sum() / max(alpha.sum(), 1e-9))


def _ignored_boxes(view, outlines, time):
    """Truth of the other carriageway, from (actor, box), not required."""
    truth = []
    for actor, box in outlines:
        if box is not None:
            inside, share = _cut(view.world, box)
            if share > 0.02:
                box, distance = tuple(inside.tolist()), _nearest(view, actor, time)
                truth.append(TruthBox(actor.identity, box, False, 0.5, distance))
    return truth


def _sensor(world, picture, time):
    """Lens, blur, exposure, noise, 8 bits."""
    rng = np.random.default_rng([world.seed, 6, round(time * 1000)])
    frame = cv2.GaussianBlur(through_lens(world.camera, picture), (0, 0), 0.7)
    noise = 1.6 * rng.standard_normal(frame.shape[:2], np.float32)
    return _develop(frame, np.float32(world.exposure), noise)


@compiled()
def _develop(frame, exposure, noise):
    """A fixed tone curve, contrast in the middle and soft in the lights; noise; 8 bits."""
    developed = np.empty(frame.shape, np.uint8)
    for row in range(frame.shape[0]):
        for column in range(frame.shape[1]):
            for c in range(3):
                light = min(max(frame[row, column, c] * exposure, 0.0), 1.3)
                tone = light * (1 + 0.25 * light) / (1.12 + 0.25 * light * light)
                value = 255 * tone + noise[row, column]
                developed[row, column, c] = np.uint8(min(max(np.rint(value), 0.0), 255.0))
    return developed
