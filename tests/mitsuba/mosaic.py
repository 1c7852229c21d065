"""Turns the parts that session.py renders into the numbers of a camera: strips, shadows, mosaic, noise, session file."""

import math

import mitsuba as mi
import numpy as np

import session
import stack
from compare import RING_DEG

# Radiance of a perfect white in air under the ring, whose radiance is 1.
WHITE = math.sin(math.radians(RING_DEG[1])) ** 2 - math.sin(math.radians(RING_DEG[0])) ** 2

# As wide as the bins of `capture` and, except for its estimate of the edge, at the same places: neighbours share little.
STRIP_MM = 10 / 360
# Beyond this, wide strips suffice for the sides, which are not measured.
STRIPS_TO_MM = 5.45
WIDE_MM = 0.5
SHADOW_MM = 0.25

# 15 bits, so that the noise of few paths never clips. Numbers above black of a perfect white; numbers per electron;
# standard deviation of the read noise.
FULL = {"R": 9500.0, "G": 13000.0, "B": 11000.0}
PER_ELECTRON = 12.0
READ = 6.0
BLACK = 512
TOP = 32767
SITES = {"R": [(0, 0)], "G": [(1, 0), (0, 1)], "B": [(1, 1)]}
# Loss of light at the corners, its rise across the frame, and the share that is scattered over it.
VIGNETTING = 0.04
SLOPE = (0.02, -0.01)
GLARE = 0.002


def load(folder, name):
    """A picture as radiance factors of each pixel, and the number of its passes."""
    path = folder / f"{name}.npz"
    if not path.exists():
        raise SystemExit(f"{path} is missing: continue with `render`")
    kept = np.load(path)
    return kept["sum"] / np.maximum(kept["count"], 1) / WHITE, int(kept["passes"])


def places_mm(camera):
    """x and y on the board of every pixel's centre, by the rays of Mitsuba's own sensor."""
    loaded = mi.load_dict(camera.sensor())

    def through(u, v):
        ray, _ = loaded.sample_ray(0.0, 0.0, [u, v], [0.5, 0.5])
        d = np.array(ray.d).ravel()
        return np.array(ray.o).ravel(), d

    # Directions of unit length along the axis are linear in the pixels.
    _, axis = through(0.5, 0.5)
    corners = [through(*uv)[1] for uv in ((0, 0), (1, 0), (0, 1))]
    corner, right, down = (d / (d @ axis) for d in corners)
    u = (np.arange(camera.width) + 0.5) / camera.width
    v = (np.arange(camera.height) + 0.5) / camera.height
    directions = corner + u[None, :, None] * (right - corner) + v[:, None, None] * (down - corner)
    origin = np.array([*camera.aside_mm, camera.distance_mm])
    hit = origin + directions * (-origin[2] / directions[..., 2])[..., None]
    return hit[..., 0], hit[..., 1]


def window_of(image, window):
    x, y, width, height = window
    return image[y : y + height, x : x + width]


def means(values, indices, count):
    """Mean of the values of each index; NaN where there are none."""
    known = (indices >= 0) & (indices < count)
    n = np.bincount(indices[known], minlength=count)
    with np.errstate(invalid="ignore"):
        return np.bincount(indices[known], weights=values[known], minlength=count) / n


class Parts:
    """All rendered parts, combined."""

    def __init__(self, folder, camera):
        self.folder, self.camera = folder, camera
        self.x, self.y = places_mm(camera)
        x, y = camera.aside_mm
        # Squared tangent of the angle between view and normal.
        self.tilt = ((self.x - x) ** 2 + (self.y - y) ** 2) / camera.distance_mm**2
        self.cover = load(folder, "board")[0] * WHITE
        self.levels = {c: self.bare_levels(c) for c in session.MEDIA}

    def bare_levels(self, channel):
        """Levels of the bare board seen straight from above, light and dark, each with its standard error; and the
        increase of both with the square of the angle of view. Half of the dark level is the coat's reflection of the
        ring, which rises as the view turns towards the ring, equally in all directions, since the ring is round."""
        image, _ = load(self.folder, f"bare_{channel}")
        is_light, is_dark = self.cover > 0.9999, self.cover < 1e-4
        tilt = self.tilt[is_dark]
        design = np.stack([np.ones(tilt.size), tilt], axis=1)
        covariance = np.linalg.inv(design.T @ design)
        level, rise = covariance @ design.T @ image[is_dark]
        noise = image[is_dark].std()
        light = image[is_light] - rise * self.tilt[is_light]
        return {
            "light": [light.mean(), light.std() / math.sqrt(light.size)],
            "dark": [level, noise * math.sqrt(covariance[0, 0])],
            "rise": [rise, noise * math.sqrt(covariance[1, 1])],
        }

    def bare(self, channel):
        level = self.levels[channel]
        light, dark, rise = (level[k][0] for k in ("light", "dark", "rise"))
        return dark + (light - dark) * self.cover + rise * self.tilt

    def strips(self, thickness, channel, shot):
        """The slab's picture: a function of x alone, since it is the same along the edge."""
        count = 2 * round(STRIPS_TO_MM / STRIP_MM)
        name = f"slab_{thickness}_{channel}_{shot}"
        image, passes = load(self.folder, name)
        if passes % session.PLACES:
            raise SystemExit(
                f"{name}: {passes} passes; a multiple of {session.PLACES} is needed, or its lens is not the board's: "
                "continue with `render`"
            )
        x = window_of(self.x, session.MIDDLE)
        strips = means(image, self.strip_of(x), count)
        assert np.isfinite(strips).all(), "a strip without a pixel"
        wide = np.floor((self.x + 15.5) / WIDE_MM).astype(int)
        sides = [
            (load(self.folder, f"side_{thickness}_{channel}_{i}")[0], window_of(wide, w))
            for i, w in enumerate(session.SIDES)
        ]
        far = means(np.concatenate([s[0].ravel() for s in sides]), np.concatenate([s[1].ravel() for s in sides]), 62)
        known = np.flatnonzero(np.isfinite(far))
        middles = (known + 0.5) * WIDE_MM - 15.5
        near = np.abs(self.x) < STRIPS_TO_MM - STRIP_MM
        picture = np.interp(self.x, middles, far[known])
        picture[near] = strips[self.strip_of(self.x[near])]
        return picture, passes

    @staticmethod
    def strip_of(x):
        return np.floor((x + round(STRIPS_TO_MM / STRIP_MM) * STRIP_MM) / STRIP_MM).astype(int)

    def shadow(self, thickness):
        """Darkening of the bare squares next to the slab, as a function of the distance from its long sides."""
        reach = np.abs(self.y) - stack.SLAB_MM[1]
        factors = np.ones(self.cover.shape)
        bare = self.bare("G")
        for share in (self.cover, 1 - self.cover):
            # Ratios over whole squares, above and below the slab together.
            indices, ratios = [], []
            for i, window in enumerate(session.BEYOND):
                whole = window_of(share, window) > 0.9999
                image = load(self.folder, f"beyond_{thickness}_{i}")[0]
                indices.append(np.floor(window_of(reach, window)[whole] / SHADOW_MM).astype(int))
                ratios.append(image[whole] / window_of(bare, window)[whole])
            found = means(np.concatenate(ratios), np.concatenate(indices), 20)
            known = np.flatnonzero(np.isfinite(found))
            factors += share * (np.interp(reach, (known + 0.5) * SHADOW_MM, found[known]) - 1)
        return factors

    def sample(self, thickness, channel, shot):
        picture, passes = self.strips(thickness, channel, shot)
        covered = load(self.folder, f"cover_{thickness}")[0] * WHITE
        free = self.bare(channel) * self.shadow(thickness)
        return covered * picture + (1 - covered) * free, passes


class Sensor:
    """Turns pictures of radiance factors into mosaics."""

    def __init__(self, camera):
        u = (np.arange(camera.width) + 0.5) / camera.width - 0.5
        v = ((np.arange(camera.height) + 0.5) / camera.height - 0.5)[:, None]
        self.light = (1 + SLOPE[0] * u + SLOPE[1] * v) * (1 - VIGNETTING * 2 * (u**2 + v**2))
        self.random = np.random.default_rng(2017)

    def take(self, pictures):
        """`pictures` by channel, or None in the dark."""
        height, width = self.light.shape
        numbers = np.zeros((height, width))
        for channel, sites in SITES.items():
            if pictures is None:
                break
            light = pictures[channel] * self.light
            light = FULL[channel] * ((1 - GLARE) * light + GLARE * light.mean())
            for x, y in sites:
                numbers[y::2, x::2] = light[y::2, x::2]
        electrons = self.random.poisson(np.maximum(numbers, 0) / PER_ELECTRON)
        noisy = BLACK + PER_ELECTRON * electrons + READ * self.random.standard_normal(numbers.shape)
        return np.clip(np.rint(noisy), 0, TOP).astype(">u2")


def write_pgm(path, numbers):
    height, width = numbers.shape
    path.write_bytes(f"P5\n{width} {height}\n{TOP}\n".encode() + numbers.tobytes())


def areas(parts):
    """Rectangles of pixels well within the patches of the chart."""
    places, _ = stack.patches(parts.camera, session.PATCHES)
    found = []
    for x, y in places:
        inside = (np.abs(parts.x - x) < 1.5) & (np.abs(parts.y - y) < 4.0)
        rows, columns = np.flatnonzero(inside.sum(1) > 55), np.flatnonzero(inside.sum(0) > 150)
        found.append([int(columns[0]), int(rows[0]), int(np.ptp(columns)), int(np.ptp(rows))])
    return found


def session_file(parts):
    samples = "".join(
        f'\n[[sample]]\nmaterial = "resin"\nthickness_mm = {t}\nthickness_std_error_mm = 0.002\n'
        f'shots = ["resin_{t}_*.pgm"]\n'
        for t in session.THICKNESSES
    )
    return f"""# Rendered by Mitsuba 3, see tests/mitsuba/session.py. The truth is in truth.json.
[camera]
pattern = "RGGB"
dark = ["dark_*.pgm"]
flat = ["flat_*.pgm"]

[neutral]
shots = ["chart_*.pgm"]
rho = {list(session.PATCHES)}
std_error = 0.002
geometry = "own"
areas_px = {areas(parts)}

[target]
bare = ["board_*.pgm"]
square_mm = {stack.SQUARE_MM}
square_std_error_mm = 0.001
dark_side = "left"
{samples}"""


def shoot(folder, output, camera):
    """Writes all photographs and the session file; returns the truth."""
    parts, sensor = Parts(folder, camera), Sensor(camera)
    alike = lambda image: dict.fromkeys(session.MEDIA, image)  # noqa: E731
    sheet, chart = (alike(load(folder, name)[0]) for name in ("sheet", "chart"))
    bare = {c: parts.bare(c) for c in session.MEDIA}
    for i in range(1, 4):
        write_pgm(output / f"dark_{i}.pgm", sensor.take(None))
        write_pgm(output / f"flat_{i}.pgm", sensor.take(sheet))
        write_pgm(output / f"chart_{i}.pgm", sensor.take(chart))
        write_pgm(output / f"board_{i}.pgm", sensor.take(bare))
    passes = []
    for t in session.THICKNESSES:
        for shot in range(session.SHOTS):
            taken = {c: parts.sample(t, c, shot) for c in session.MEDIA}
            passes += [p for _, p in taken.values()]
            write_pgm(output / f"resin_{t}_{shot + 1}.pgm", sensor.take({c: v for c, (v, _) in taken.items()}))
    (output / "session.toml").write_text(session_file(parts), encoding="utf-8")
    names = ("sigma_t_per_mm", "albedo", "g")
    return {
        "media": {c: dict(zip(names, medium)) for c, medium in session.MEDIA.items()},
        "rho": session.RHO,
        "seen_bare": parts.levels,
        "px_per_mm": camera.px_per_mm,
        "lens_mm": float(np.std(session.LENS_PX)) / camera.px_per_mm,
        "glare": GLARE,
        "passes": [min(passes), max(passes)],
    }
