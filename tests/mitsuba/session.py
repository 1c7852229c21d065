#!/usr/bin/env python3
"""A session of photographs rendered by Mitsuba 3, for `farmctl capture`: its truth is known, its renderer not ours.

A perspective camera 1 m above a checkerboard takes an even sheet, grey patches, the bare board, and slabs of 30 mm by
20 mm in two thicknesses, in the scene `paper` with sides: see stack.py. The pictures then go through a lens, a sensor
and a mosaic: see mosaic.py.

    python3 -m venv venv && venv/bin/pip install mitsuba numpy
    venv/bin/python tests/mitsuba/session.py render -o rendered      # an hour or more; continues where it was stopped
    venv/bin/python tests/mitsuba/session.py shoot rendered -o photographs
    farmctl capture photographs/session.toml -o resin
    farmctl measure resin --g 0.4

Slabs are path-traced within 5 mm of the edge, on either side and along it. One path in six finds the ring, so
single pixels stay noisy: `shoot` takes the mean along the edge, in strips as wide as the bins of `capture`. What
noise remains differs from shot to shot, since every shot has paths of its own, so `capture` sees it and counts it.
Parts without a slab are even, except for the shadow next to the slab: they are painted with the mean of what was
rendered, each pixel by how much of it they cover.

Mitsuba's LLVM variants need LLVM's library (DRJIT_LIBLLVM_PATH names it): Debian's libllvm19 does with AVX-512,
libllvm16 and older abort. Without it the scalar variant is used, about half as fast.
"""

import argparse
import json
from pathlib import Path

import mitsuba as mi
import numpy as np

import stack
from compare import choose_variant

# White of the paper's Table 1 in red and green, its cyan's blue in blue: σ_t per mm, α and g.
MEDIA = {"R": (6.0, 0.9991, 0.4), "G": (9.0, 0.9997, 0.4), "B": (7.5, 0.98, 0.4)}
RHO = {"R": (0.985, 0.024), "G": (0.972, 0.023), "B": (0.971, 0.026)}
THICKNESSES = (0.5, 1.0)
SHOTS = 3
PATCHES = (0.956, 0.594, 0.361, 0.193, 0.090, 0.032)
SHEET = 0.9
# The lens, close to a Gaussian: offsets of the picture against the sensor in pixels, each with separate paths. The vertical
# ones have another order than the horizontal ones, so that both are uncorrelated.
LENS_PX = (-1.4609, 1.4609, -0.2688, 0.2688, -0.6852, 0.6852)
UP_PX = (-0.2688, 0.2688, -0.6852, -1.4609, 1.4609, 0.6852)
PLACES = len(LENS_PX)
# Pixels: x, y, width, height. The middle is measured, the sides and the strips beyond the slab are only seen.
MIDDLE = (188, 190, 224, 200)
SIDES = ((0, 190, 188, 200), (412, 190, 188, 200))
BEYOND = ((0, 0, 600, 86), (0, 494, 600, 86))


def parse():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = p.add_subparsers(dest="command", required=True)
    render = commands.add_parser("render", help="path-trace the parts of all pictures")
    render.add_argument("-o", "--output", type=Path, required=True)
    render.add_argument("--spp", type=int, default=1, help="samples per pixel, pass and shot of the slabs (default 1)")
    render.add_argument("--rounds", type=int, default=6, help="of all places of the lens, of the slabs (default 6)")
    render.add_argument("--variant", help="Mitsuba variant (default: llvm_ad_mono, else scalar_rgb)")
    shoot = commands.add_parser("shoot", help="write photographs and session file from the parts")
    shoot.add_argument("rendered", type=Path)
    shoot.add_argument("-o", "--output", type=Path, required=True)
    return p.parse_args()


class Picture:
    """Sums of a window's values and their numbers, kept in a file after each pass."""

    def __init__(self, path):
        self.path = path
        self.passes = 0
        self.sum = self.count = 0
        if path.exists():
            kept = np.load(path)
            self.passes, self.sum, self.count = int(kept["passes"]), kept["sum"], kept["count"]

    def add(self, image):
        # Mitsuba's rough dielectric sometimes returns NaN: such a value is left out.
        fine = np.isfinite(image)
        self.sum = self.sum + np.where(fine, image, 0.0)
        self.count = self.count + fine
        self.passes += 1
        part = self.path.with_suffix(".part.npz")
        np.savez(part, passes=self.passes, sum=self.sum, count=self.count)
        part.replace(self.path)


class Renderer:
    def __init__(self, folder, camera):
        self.folder, self.camera = folder, camera
        self.scenes = {}

    def passes(self, name, build, spp, wanted, seed):
        """Renders up to this many passes of a picture, each with another offset of the lens."""
        picture = Picture(self.folder / f"{name}.npz")
        while picture.passes < wanted:
            if name not in self.scenes:
                self.scenes[name] = mi.load_dict(build())
            loaded = self.scenes[name]
            place = picture.passes % PLACES
            parameters = mi.traverse(loaded)
            parameters["sensor.principal_point_offset_x"] = LENS_PX[place] / self.camera.width
            parameters["sensor.principal_point_offset_y"] = UP_PX[place] / self.camera.height
            parameters.update()
            image = np.array(mi.render(loaded, spp=spp, seed=seed + 1000 * picture.passes))
            picture.add(image[..., 0].astype(float))
            print(f"{name}: pass {picture.passes} of {wanted}", flush=True)

    def all(self, spp, rounds):
        camera = self.camera
        self.passes("board", lambda: stack.lit_board(camera), 64, PLACES, 1)
        self.passes("chart", lambda: stack.patches(camera, PATCHES)[1], 8, 2 * PLACES, 2)
        self.passes("sheet", lambda: stack.sheet(camera, SHEET), 8, 2 * PLACES, 3)
        for i, (channel, rho) in enumerate(RHO.items()):
            self.passes(f"bare_{channel}", lambda: stack.bare(camera, rho), 2, 6 * PLACES, 10 + i)
        for t in THICKNESSES:
            self.passes(f"cover_{t}", lambda: stack.lit_slab(camera, t), 64, PLACES, 4)
            for i, window in enumerate(BEYOND):
                build = lambda: stack.slab(camera, MEDIA["G"], t, RHO["G"], window)  # noqa: E731
                self.passes(f"beyond_{t}_{i}", build, 1, PLACES, 20 + i)
        for wanted in range(1, rounds * PLACES + 1):
            self.slabs(spp, wanted)

    def slabs(self, spp, wanted):
        for t in THICKNESSES:
            for i, channel in enumerate(MEDIA):
                for shot in range(SHOTS):
                    self.slab(f"slab_{t}_{channel}_{shot}", t, channel, MIDDLE, spp, wanted, 100 + 10 * i + shot)
                if wanted == 1:
                    for side, window in enumerate(SIDES):
                        self.slab(f"side_{t}_{channel}_{side}", t, channel, window, 1, wanted, 200 + 10 * i + side)

    def slab(self, name, t, channel, window, spp, wanted, seed):
        build = lambda: stack.slab(self.camera, MEDIA[channel], t, RHO[channel], window)  # noqa: E731
        self.passes(name, build, spp, wanted, seed + int(1e6 * t))


def main():
    args = parse()
    camera = stack.Camera()
    if args.command == "render":
        print(f"Mitsuba {mi.__version__} {choose_variant(args.variant)}")
        args.output.mkdir(parents=True, exist_ok=True)
        Renderer(args.output, camera).all(args.spp, args.rounds)
    else:
        choose_variant("scalar_rgb")
        import mosaic

        args.output.mkdir(parents=True, exist_ok=True)
        truth = mosaic.shoot(args.rendered, args.output, camera)
        (args.output / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
