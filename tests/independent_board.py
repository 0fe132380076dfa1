"""A renderer of calibration poses that shares neither code nor convention with the simulator: a second opinion.

Its conventions, all of which differ from the house's:

- Metres. The world is the camera's own frame as graphics have it: x right, y up, the camera looks along -z.
- A board's frame has x right, y up and z out of the paper. It is turned by yaw (about y), then pitch (about its new x),
  then roll (about its newest z), like an aircraft; a board without angles faces the camera upright.
- A picture's origin is its lower left corner, t runs up, pixels have their corners at integers.
- A lens is told by its vertical field of view, the width of a pixel over its height, and the shift of its axis as a
  share of the picture's height. Its distortion is in radii of half the picture's height: x' = x (1 + a r^2 + b r^4) and
  Conrady's decentring m, n. Rays of pixels are found by Newton's method.
- The projector stands at `eye`, looks at `target`, and is rolled about its axis.
- A pixel's value is the mean over 10 x 10 rays wherever an edge may cross it; its phase is that of the mean phasor, as
  a camera sees it. Light falls off with distance and angle, both lenses are darker at their corners, ambient light
  comes from everywhere, and sensor noise is Gaussian.

`camera_of`, `projector_of`, `pose_of` and `phase_maps` return the same truth in the house's conventions.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from fringed.data import Lens, PhaseMap, Reject

Array = np.ndarray[Any, Any]
SAMPLES = 10
_FLIP = np.diag([1.0, -1.0, -1.0])  # the house's axes: y down, z forwards


@dataclass(frozen=True)
class Glass:
    """A lens and its picture; see the module's docstring."""

    width: int
    height: int
    fov_y_deg: float
    pixel_aspect: float = 1.0
    shift: tuple[float, float] = (0.0, 0.0)
    radial: tuple[float, float] = (0.0, 0.0)
    decentring: tuple[float, float] = (0.0, 0.0)
    corner_loss: float = 0.0

    @property
    def half(self) -> float:
        """Half the picture's height at distance 1."""
        return float(np.tan(np.radians(self.fov_y_deg) / 2))

    def bent(self, slopes: Array) -> Array:
        """Return where distortion puts slopes (..., 2), x and y over distance."""
        r = slopes / self.half
        square = (r**2).sum(axis=-1, keepdims=True)
        radial = 1 + self.radial[0] * square + self.radial[1] * square**2
        m = np.array(self.decentring)
        along = (r * m).sum(axis=-1, keepdims=True)
        return np.asarray((r * radial + m * square + 2 * along * r) * self.half)

    def straight(self, bent: Array) -> Array:
        """Return the slopes that distortion takes to `bent`, by Newton's method."""
        slopes, step = bent.copy(), 1e-6
        for _ in range(8):
            here = self.bent(slopes)
            dx = (self.bent(slopes + np.array([step, 0.0])) - here) / step
            dy = (self.bent(slopes + np.array([0.0, step])) - here) / step
            off = bent - here
            det = dx[..., 0] * dy[..., 1] - dy[..., 0] * dx[..., 1]
            slopes[..., 0] += (off[..., 0] * dy[..., 1] - off[..., 1] * dy[..., 0]) / det
            slopes[..., 1] += (off[..., 1] * dx[..., 0] - off[..., 0] * dx[..., 1]) / det
            if np.abs(off).max() < 1e-12:
                break
        return slopes

    def place(self, points: Array) -> Array:
        """Return s, t (..., 2) of points (..., 3) in the lens's own frame."""
        bent = self.bent(points[..., :2] / -points[..., 2:])
        per_slope = self.height / 2 / self.half
        scale = np.array([per_slope / self.pixel_aspect, per_slope])
        return np.asarray(bent * scale + self._centre())

    def rays(self, st: Array) -> Array:
        """Return the directions (..., 3) that the lens takes to s, t."""
        per_slope = self.height / 2 / self.half
        slopes = self.straight((st - self._centre()) / np.array([per_slope / self.pixel_aspect, per_slope]))
        return np.concatenate([slopes, np.full((*slopes.shape[:-1], 1), -1.0)], axis=-1)

    def brightness(self, st: Array) -> Array:
        """Return the light that the lens lets through at s, t, 1 in the picture's middle."""
        off = (st - [self.width / 2, self.height / 2]) / [self.width / 2, self.height / 2]
        return np.asarray(1 - self.corner_loss * (off**2).sum(axis=-1) / 2)

    def _centre(self) -> Array:
        return np.array([self.width / 2, self.height / 2]) + np.array(self.shift) * self.height


@dataclass(frozen=True)
class Beamer:
    """A projector: its lens, where it stands, what it looks at (m), and how far it is rolled."""

    glass: Glass
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    roll_deg: float = 0.0

    def axes(self) -> Array:
        """Return its x, y and z axes as rows, in the world."""
        back = np.subtract(self.eye, self.target)
        back = back / np.linalg.norm(back)
        right = np.cross([0.0, 1.0, 0.0], back)
        right /= np.linalg.norm(right)
        up = np.cross(back, right)
        c, s = np.cos(np.radians(self.roll_deg)), np.sin(np.radians(self.roll_deg))
        return np.array([c * right + s * up, c * up - s * right, back])

    def place(self, points: Array) -> Array:
        """Return s, t of points (..., 3) of the world."""
        return self.glass.place((points - np.array(self.eye)) @ self.axes().T)


@dataclass(frozen=True)
class Circles:
    """A board of `columns` x `rows` dark circles, both odd, the five large ones as the thesis has them; metres."""

    columns: int = 13
    rows: int = 9
    pitch: float = 0.020
    diameter: float = 0.009
    large: float = 0.014
    paper: float = 0.9
    ink: float = 0.07

    def sheet(self) -> tuple[float, float]:
        """Return half of the paper's width and height."""
        return (self.columns + 1) * self.pitch / 2, (self.rows + 1) * self.pitch / 2

    def outside(self, xy: Array) -> Array:
        """Return how far points (..., 2) are outside of the nearest circle, negative inside."""
        # Right and up from the middle: itself, two to each side, two down, and two right and two up.
        five = {(0, 0), (-2, 0), (2, 0), (0, -2), (2, 2)}
        across, up = self.columns // 2, self.rows // 2
        radius = np.full((2 * across + 1, 2 * up + 1), self.diameter / 2)
        for i, j in five:
            radius[i + across, j + up] = self.large / 2
        nearest = np.clip(np.round(np.nan_to_num(xy / self.pitch)), [-across, -up], [across, up]).astype(int)
        far = np.linalg.norm(xy - nearest * self.pitch, axis=-1)
        return np.asarray(far - radius[nearest[..., 0] + across, nearest[..., 1] + up])


@dataclass(frozen=True)
class Stand:
    """Where a board is: its middle (m) and its yaw, pitch, roll (degrees)."""

    at: tuple[float, float, float]
    ypr_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def turn(self) -> Array:
        """Return the rotation whose columns are the board's axes in the world."""
        (cy, cp, cr), (sy, sp, sr) = np.cos(np.radians(self.ypr_deg)), np.sin(np.radians(self.ypr_deg))
        yaw = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        pitch = np.array([[1, 0, 0], [0, cp, -sp], [0, sp, cp]])
        roll = np.array([[cr, -sr, 0], [sr, cr, 0], [0, 0, 1]])
        return np.asarray(yaw @ pitch @ roll)


@dataclass(frozen=True)
class Light:
    """Grey levels: of the `lamp` on white at 1 m, `ambient`, the sensor's `noise`; and how many frames tell a phase."""

    lamp: float = 160.0
    ambient: float = 20.0
    noise: float = 0.6
    frames: int = 12


@dataclass(frozen=True)
class Shot:
    """One pose as seen: the fringe-free picture, both phases and their deviations, (height, width), top row first."""

    picture: Array
    phases: tuple[Array, Array]
    sigmas: tuple[Array, Array]
    modulation: Array
    on_paper: Array
    stand: Stand
    periods: tuple[float, float]


@dataclass(frozen=True)
class Bench:
    """Camera, projector, board and light; `shoot` renders a pose."""

    camera: Glass
    beamer: Beamer
    board: Circles = field(default_factory=Circles)
    light: Light = field(default_factory=Light)
    periods: tuple[float, float] = (16.0, 16.0)

    def shoot(self, stand: Stand, seed: int = 0) -> Shot:
        """Return what the camera sees of the board."""
        st, rays = self._middles
        means, edge = self._seen(st, rays, stand), self._edges(stand)
        corners = self._corners[edge]
        inner = (np.arange(SAMPLES) + 0.5) / SAMPLES
        right, down = (part.ravel()[:, None] for part in np.meshgrid(inner, inner))
        # Inside of one pixel no lens bends a line that could be measured.
        upper = corners[:, 0, None] * (1 - right) + corners[:, 1, None] * right
        lower = corners[:, 2, None] * (1 - right) + corners[:, 3, None] * right
        around = st[edge][:, None] + np.concatenate([right - 0.5, 0.5 - down], axis=1)
        for value, fine in zip(means, self._seen(around, upper * (1 - down) + lower * down, stand), strict=True):
            value[edge] = fine.mean(axis=1)
        return self._noisy(means, stand, np.random.default_rng(seed))

    @cached_property
    def _middles(self) -> tuple[Array, Array]:
        """Return s, t of the pixels' middles (height, width, 2), the top row first, and their rays."""
        height, width = self.camera.height, self.camera.width
        st = np.stack(np.meshgrid(np.arange(width) + 0.5, height - np.arange(height) - 0.5), axis=-1)
        return st, self.camera.rays(st)

    @cached_property
    def _corners(self) -> Array:
        """Return the rays of each pixel's corners (height, width, 4, 3): upper left, upper right, lower ones."""
        height, width = self.camera.height, self.camera.width
        st = np.stack(np.meshgrid(np.arange(width + 1.0), height - np.arange(height + 1.0)), axis=-1)
        rays = self.camera.rays(st)
        return np.stack([rays[:-1, :-1], rays[:-1, 1:], rays[1:, :-1], rays[1:, 1:]], axis=2)

    def _hit(self, rays: Array, stand: Stand) -> tuple[Array, Array]:
        """Return where rays meet the board: in the world, and on the board (x, y)."""
        turn, at = stand.turn(), np.array(stand.at)
        distance = (at @ turn[:, 2]) / (rays @ turn[:, 2])
        world = rays * distance[..., None]
        return world, (world - at) @ turn[:, :2]

    def _seen(self, st: Array, rays: Array, stand: Stand) -> list[Array]:
        """Return the steady light, the modulated phasors of both directions, and how much is paper."""
        world, xy = self._hit(rays, stand)
        on = (np.abs(xy) <= np.array(self.board.sheet())).all(axis=-1)
        albedo = np.where(self.board.outside(xy) < 0, self.board.ink, self.board.paper) * on
        towards = np.array(self.beamer.eye) - world
        far = np.linalg.norm(towards, axis=-1)
        cosine = np.clip((towards @ stand.turn()[:, 2]) / far, 0, None)
        lit = self.beamer.place(world)
        inside = ((lit >= 0) & (lit <= [self.beamer.glass.width, self.beamer.glass.height])).all(axis=-1)
        lamp = self.light.lamp * cosine / far**2 * self.beamer.glass.brightness(lit) * inside
        through = self.camera.brightness(st) * albedo
        swing = through * lamp / 2
        phasors = [swing * np.exp(1j * self._count(axis, lit)) for axis in range(2)]
        return [through * (self.light.ambient + lamp / 2), *phasors, on * inside + 0.0]

    def _edges(self, stand: Stand) -> Array:
        """Return the pixels that an edge of a circle or of the paper may cross: nearer than their farthest corner."""
        middle = self._hit(self._middles[1], stand)[1]
        corners = self._hit(self._corners, stand)[1]
        reach = 1.01 * np.linalg.norm(corners - middle[:, :, None], axis=-1).max(axis=-1)
        beyond = (np.abs(middle) - np.array(self.board.sheet())).max(axis=-1)
        return np.asarray((np.abs(self.board.outside(middle)) < reach) | (np.abs(beyond) < reach))

    def _noisy(self, means: list[Array], stand: Stand, random: np.random.Generator) -> Shot:
        steady, across, along, paper = means
        frames, noise = self.light.frames, self.light.noise
        lit = self.beamer.place(self._hit(self._middles[1], stand)[0])
        picture = steady + random.normal(size=steady.shape) * noise / np.sqrt(2 * frames)
        on = paper > 0.999
        phases, sigmas = [], []
        for axis, phasor in enumerate((across, along)):
            swing = np.maximum(np.abs(phasor), 1e-9)
            sigma = np.sqrt(2 / frames) * noise / swing
            whole = self._count(axis, lit)
            fine = np.angle(phasor)
            absolute = fine + 2 * np.pi * np.round((whole - fine) / (2 * np.pi))
            phases.append(np.where(on, absolute + random.normal(size=steady.shape) * sigma, np.nan))
            sigmas.append(sigma)
        return Shot(picture, (phases[0], phases[1]), (sigmas[0], sigmas[1]), np.abs(across), on, stand, self.periods)

    def _count(self, axis: int, lit: Array) -> Array:
        """Return the absolute phase where the projector's s, t are `lit`: rows are counted from the top."""
        place = lit[..., 0] if axis == 0 else self.beamer.glass.height - lit[..., 1]
        return np.asarray(2 * np.pi * place / self.periods[axis])


def _house_lens(glass: Glass) -> Lens:
    fy = glass.height / 2 / glass.half
    cx = glass.width / 2 + glass.shift[0] * glass.height - 0.5
    cy = glass.height / 2 - glass.shift[1] * glass.height - 0.5
    matrix = np.array([[fy / glass.pixel_aspect, 0, cx], [0, fy, cy], [0, 0, 1]])
    (a, b), (m, n), h = glass.radial, glass.decentring, glass.half
    # r is in halves of the picture's height; y runs up here: x (n y) changes its sign, and so does y itself.
    return Lens(glass.width, glass.height, matrix, np.array([a / h**2, b / h**4, -n / h, m / h, 0.0]))


def camera_of(bench: Bench) -> Lens:
    """Return the camera as the house tells it."""
    return _house_lens(bench.camera)


def projector_of(bench: Bench) -> tuple[Lens, Array]:
    """Return the projector's lens and T_projector_camera (mm) as the house tells them."""
    T = np.eye(4)
    T[:3, :3] = _FLIP @ bench.beamer.axes() @ _FLIP
    T[:3, 3] = -1000 * T[:3, :3] @ _FLIP @ np.array(bench.beamer.eye)
    return _house_lens(bench.beamer.glass), T


def pose_of(stand: Stand) -> Array:
    """Return T_camera_board (mm) as the house tells it."""
    T = np.eye(4)
    T[:3, :3] = _FLIP @ stand.turn() @ _FLIP
    T[:3, 3] = 1000 * _FLIP @ np.array(stand.at)
    return T


def phase_maps(bench: Bench, shot: Shot) -> dict[str, PhaseMap]:
    """Return both phase maps as a decoder would give them: the phase is 0 at the first pixel's outer edge."""
    maps, sizes = {}, (bench.beamer.glass.width, bench.beamer.glass.height)
    for axis, name in enumerate(("columns", "rows")):
        maps[name] = PhaseMap(
            phase_rad=shot.phases[axis].astype(np.float32), modulation=shot.modulation.astype(np.float32),
            background=shot.picture.astype(np.float32),
            rejected=np.where(shot.on_paper, 0, int(Reject.LOW_MODULATION)).astype(np.uint16), kind="absolute",
            period_px=bench.periods[axis], orientation="columns" if axis == 0 else "rows",
            initial_phase_rad=float(np.pi / bench.periods[axis]), sigma_rad=shot.sigmas[axis].astype(np.float32),
            projector_px=sizes[axis],
        )  # fmt: skip
    return maps
