"""Builds scenes for session.py: a slab of finite size on a checkerboard under a ring of light, before a perspective camera.

Lengths are in mm. The board lies at z = 0 with the edge in use at x = 0, dark where x < 0 and |y| < half a square.
"""

import math
from dataclasses import dataclass

import mitsuba as mi

from compare import BASE_ROUGHNESS, COAT_IOR, GEL, GLASS, SAMPLE_ROUGHNESS, ring_light

# Well above the offset by which Mitsuba starts new rays, which is 1.5 µm at 15 mm from the origin.
COAT_MM = 4e-3
SQUARE_MM = 24.0
# Squares each way: the edge in use is a line between two columns, and goes through the middle of a row.
COLUMNS, ROWS = 10, 9
# Half of the slab's sides: a free line of the board lies 2 mm beyond its long sides.
SLAB_MM = (15.0, 10.0)
SAMPLE_IOR = 1.53
# Walks end long before this depth, except for those that slip through a seam between two faces and would never end.
ROULETTE_DEPTH = 3000


@dataclass(frozen=True)
class Camera:
    """A camera straight above, except for a small tilt, and turned against the edge."""

    width: int = 600
    height: int = 580
    px_per_mm: float = 20.0
    distance_mm: float = 1000.0
    # Its position relative to the edge: a tilt of 0.3° across it and 0.2° along it.
    aside_mm: tuple = (5.2, -3.5)
    turn_deg: float = 1.4

    def sensor(self, window=None, sampler="independent"):
        """The sensor of a window of pixels (x, y, width, height)."""
        t = mi.ScalarTransform4f
        turn = math.radians(self.turn_deg)
        film = {
            "type": "hdrfilm",
            "width": self.width,
            "height": self.height,
            "rfilter": {"type": "box"},
            "pixel_format": "luminance",
        }
        if window:
            film |= dict(zip(("crop_offset_x", "crop_offset_y", "crop_width", "crop_height"), window))
        return {
            "type": "perspective",
            "fov_axis": "x",
            "fov": math.degrees(2 * math.atan(0.5 * self.width / self.px_per_mm / self.distance_mm)),
            "near_clip": 10.0,
            "far_clip": 2000.0,
            "to_world": t().look_at(
                origin=[*self.aside_mm, self.distance_mm], target=[0, 0, 0], up=[math.sin(turn), math.cos(turn), 0]
            ),
            "film": film,
            "sampler": {"type": sampler},
        }


def rectangle(z, x, y, bsdf, **more):
    """A rectangle that spans x = (from, to) and y = (from, to), its outside above."""
    t = mi.ScalarTransform4f
    to_world = t().translate([sum(x) / 2, sum(y) / 2, z]) @ t().scale([(x[1] - x[0]) / 2, (y[1] - y[0]) / 2, 1])
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf, **more}


def dielectric(inside, outside, roughness=0.0):
    """An interface between two indices; the inside is below a face, or within a wall."""
    bsdf = {"type": "dielectric", "int_ior": inside, "ext_ior": outside}
    return bsdf | ({"type": "roughdielectric", "distribution": "ggx", "alpha": roughness} if roughness else {})


def diffuse(rho):
    return {"type": "diffuse", "reflectance": {"type": "spectrum", "value": rho}}


def walls(z0, z1, bsdf, **more):
    """The four sides of a layer of the slab, their outsides outward."""
    t = mi.ScalarTransform4f
    half = (z1 - z0) / 2
    found = {}
    for i, (axis, along, out) in enumerate(
        [([0, 1, 0], SLAB_MM[1], SLAB_MM[0]), ([1, 0, 0], SLAB_MM[0], SLAB_MM[1])] * 2
    ):
        sign = 1 if i < 2 else -1
        # A turn about y takes the outside from +z to ±x, one about x to ±y.
        angle = 90 * sign if axis == [0, 1, 0] else -90 * sign
        place = [sign * out, 0, z0 + half] if axis == [0, 1, 0] else [0, sign * out, z0 + half]
        scale = [half, along, 1] if axis == [0, 1, 0] else [along, half, 1]
        to_world = t().translate(place) @ t().rotate(axis, angle) @ t().scale(scale)
        found[f"wall_{z0:.4f}_{i}".replace(".", "_")] = {
            "type": "rectangle",
            "to_world": to_world,
            "bsdf": bsdf,
            **more,
        }
    return found


def board(light, dark):
    """A checkerboard, light to the right of the edge in use."""
    t = mi.ScalarTransform4f
    x, y = COLUMNS * SQUARE_MM / 2, ROWS * SQUARE_MM / 2
    value = lambda v: {"type": "spectrum", "value": v}  # noqa: E731
    texture = {
        "type": "checkerboard",
        "color0": value(dark),
        "color1": value(light),
        "to_uv": t().scale([COLUMNS / 2, ROWS / 2, 1]),
    }
    return rectangle(0.0, (-x, x), (-y, y), {"type": "diffuse", "reflectance": texture})


def extent():
    return COLUMNS * SQUARE_MM / 2, ROWS * SQUARE_MM / 2


def scene(camera, window=None, max_depth=-1, **things):
    integrator = {"type": "volpath", "max_depth": max_depth, "rr_depth": ROULETTE_DEPTH}
    return {"type": "scene", "integrator": integrator, "sensor": camera.sensor(window), **things}


def bare(camera, rho, window=None):
    """The coated board without anything on it."""
    x, y = extent()
    coat = rectangle(COAT_MM, (-x, x), (-y, y), dielectric(COAT_IOR, 1.0, BASE_ROUGHNESS))
    return scene(camera, window, board=board(*rho), coat=coat, ring=ring_light())


def around_the_slab():
    """The coat in air: four rectangles around the slab."""
    (bx, by), (x, y) = extent(), SLAB_MM
    spans = [((-bx, -x), (-by, by)), ((x, bx), (-by, by)), ((-x, x), (-by, -y)), ((-x, x), (y, by))]
    coat = dielectric(COAT_IOR, 1.0, BASE_ROUGHNESS)
    return {f"coat_{i}": rectangle(COAT_MM, *span, coat) for i, span in enumerate(spans)}


def heights(thickness):
    """Heights of the coat, the sample's lower and upper face, the glass and the air."""
    z = [COAT_MM]
    for layer in (GEL[1], thickness, GEL[1], GLASS[1]):
        z.append(z[-1] + layer)
    return z


def slab(camera, medium, thickness, rho, window=None):
    """The stack of the scene `paper` with sides, on the board. `medium` is σ_t per mm, α and g."""
    sigma_t, albedo, g = medium
    sample = {
        "type": "homogeneous",
        "sigma_t": sigma_t,
        "albedo": albedo,
        "phase": {"type": "hg", "g": g},
        # Interfaces between the sample and the light stop every shadow ray.
        "sample_emitters": False,
    }
    ref = {"type": "ref", "id": "sample"}
    coat, bottom, top, glass, air = heights(thickness)
    x, y = ((-half, half) for half in SLAB_MM)
    n = SAMPLE_IOR
    return scene(
        camera,
        window,
        medium=sample | {"id": "sample"},
        board=board(*rho),
        coat=rectangle(coat, x, y, dielectric(COAT_IOR, GEL[0], BASE_ROUGHNESS)),
        bottom=rectangle(bottom, x, y, dielectric(GEL[0], n, SAMPLE_ROUGHNESS), exterior=ref),
        top=rectangle(top, x, y, dielectric(n, GEL[0], SAMPLE_ROUGHNESS), interior=ref),
        glass=rectangle(glass, x, y, dielectric(GEL[0], GLASS[0])),
        air=rectangle(air, x, y, dielectric(GLASS[0], 1.0)),
        **around_the_slab(),
        **walls(coat, bottom, dielectric(GEL[0], 1.0)),
        **walls(bottom, top, dielectric(n, 1.0, SAMPLE_ROUGHNESS), interior=ref),
        **walls(top, glass, dielectric(GEL[0], 1.0)),
        **walls(glass, air, dielectric(GLASS[0], 1.0)),
        ring=ring_light(),
    )


def lit(camera, shape, radiance):
    """A scene of a glowing shape before black, which renders the share of each pixel that it covers."""
    integrator = {"type": "path", "max_depth": 1}
    glowing = shape | {"emitter": {"type": "area", "radiance": radiance}}
    return {"type": "scene", "integrator": integrator, "sensor": camera.sensor(None, "multijitter"), "shape": glowing}


def lit_board(camera):
    """A scene that renders the share of each pixel that is covered by the board's light squares."""
    shape = board(1.0, 0.0)
    return lit(camera, shape, shape["bsdf"]["reflectance"])


def lit_slab(camera, thickness):
    x, y = ((-half, half) for half in SLAB_MM)
    return lit(camera, rectangle(heights(thickness)[-1], x, y, diffuse(0.5)), {"type": "spectrum", "value": 1.0})


def patches(camera, rho):
    """Grey squares of a chart on grey, in air: their places, and the scene."""
    width = 4.0
    places = [(4.6 * (i - (len(rho) - 1) / 2), 0.0) for i in range(len(rho))]
    things = {
        f"patch_{i}": rectangle(0.1, (x - width / 2, x + width / 2), (-5.0, 5.0), diffuse(r))
        for i, ((x, _), r) in enumerate(zip(places, rho))
    }
    return places, scene(camera, None, 2, ground=even(0.19), ring=ring_light(), **things)


def even(rho):
    x, y = extent()
    return rectangle(0.0, (-x, x), (-y, y), diffuse(rho))


def sheet(camera, rho):
    return scene(camera, None, 2, ground=even(rho), ring=ring_light())
