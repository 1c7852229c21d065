#!/usr/bin/env python3
"""Path-trace one edge profile with Mitsuba 3 and trace the same with farmctl, side by side.

Prints for both the time, the noise and how well they agree, and the ratio of the times that they need for the same
error. A walk of farmctl serves all pixels at once, which Mitsuba's paths do not: that is most of the ratio for one
profile. In a dictionary its walks serve 41 albedos and 3 channels besides, which is not counted here.

    python3 -m venv venv && venv/bin/pip install mitsuba numpy
    cargo build --release
    venv/bin/python tests/mitsuba/compare.py

Mitsuba's LLVM variants need LLVM's library (Debian: libllvm16 or later); without it the scalar variant is used.
"""

import argparse
import csv
import io
import math
import subprocess
import time
from pathlib import Path

import mitsuba as mi
import numpy as np

ROOT = Path(__file__).resolve().parents[2]
# The scene `paper`, see README.md; lengths in mm, from the top.
GLASS, GEL, COAT_IOR = (1.52, 0.17), (1.33, 0.02), 1.49
SAMPLE_ROUGHNESS, BASE_ROUGHNESS = 0.05, 0.15
RING_DEG = (40.0, 50.0)
# The coat has no thickness in the model; here it must be well above the offset by which Mitsuba starts new rays.
COAT_MM = 2e-3
HALF_EXTENT_MM = 200.0


def parse():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--sigma-t", type=float, default=6.0, help="per mm (default 6)")
    p.add_argument("--albedo", type=float, default=0.9991)
    p.add_argument("--g", type=float, default=0.4)
    p.add_argument("--thickness", type=float, default=0.5, help="mm (default 0.5)")
    p.add_argument("--sample-ior", type=float, default=1.53)
    p.add_argument("--rho", type=float, nargs=2, default=(0.985, 0.024), metavar=("LIGHT", "DARK"))
    p.add_argument("--width", type=float, default=5.0, help="mm (default 5)")
    p.add_argument("--pixels", type=int, default=100)
    p.add_argument("--spp", type=int, default=256, help="samples per pixel and pass (default 256)")
    p.add_argument("--passes", type=int, default=16, help="independent passes, for the error (default 16)")
    p.add_argument("--walks", type=int, default=1_000_000, help="walks of farmctl (default 1,000,000)")
    p.add_argument("--farmctl", default=ROOT / "target/release/farmctl")
    p.add_argument("--variant", help="Mitsuba variant (default: llvm_ad_mono, else scalar_rgb)")
    return p.parse_args()


def choose_variant(wanted):
    if wanted:
        mi.set_variant(wanted)
        return wanted
    try:
        mi.set_variant("llvm_ad_mono")
        mi.load_dict({"type": "sphere"})
        return "llvm_ad_mono"
    except Exception:
        mi.set_variant("scalar_rgb")
        return "scalar_rgb"


def interface(z, above, below, roughness, medium_above=None, medium_below=None):
    """A horizontal plane; its outside is above."""
    bsdf = {"type": "dielectric", "int_ior": below, "ext_ior": above}
    if roughness:
        bsdf |= {"type": "roughdielectric", "distribution": "ggx", "alpha": roughness}
    t = mi.ScalarTransform4f
    plane = {
        "type": "rectangle",
        "to_world": t().translate([0, 0, z]) @ t().scale([HALF_EXTENT_MM, HALF_EXTENT_MM, 1]),
        "bsdf": bsdf,
    }
    if medium_above:
        plane["exterior"] = medium_above
    if medium_below:
        plane["interior"] = medium_below
    return plane


def half_base(side, rho):
    t = mi.ScalarTransform4f
    return {
        "type": "rectangle",
        "to_world": t().translate([side * HALF_EXTENT_MM / 2, 0, 0])
        @ t().scale([HALF_EXTENT_MM / 2, HALF_EXTENT_MM, 1]),
        "bsdf": {"type": "diffuse", "reflectance": {"type": "spectrum", "value": rho}},
    }


def ring_light():
    """Radiance 1 between two polar angles about z, which for an environment map is up after a turn about x."""
    rows = 3600
    polar = (np.arange(rows) + 0.5) * 180 / rows
    lit = ((polar > RING_DEG[0]) & (polar < RING_DEG[1])).astype(np.float32)
    image = np.repeat(lit[:, None, None], 8, axis=1).repeat(3, axis=2)
    return {
        "type": "envmap",
        "bitmap": mi.Bitmap(image),
        "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90),
    }


def scene(args):
    t = mi.ScalarTransform4f
    medium = {
        "type": "homogeneous",
        "sigma_t": args.sigma_t,
        "albedo": args.albedo,
        "phase": {"type": "hg", "g": args.g},
    }
    z_coat = COAT_MM
    z_bottom = z_coat + GEL[1]
    z_top = z_bottom + args.thickness
    z_glass = z_top + GEL[1]
    z_air = z_glass + GLASS[1]
    n = args.sample_ior
    return {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": -1, "rr_depth": 100_000},
        "medium": medium | {"id": "sample"},
        "air": interface(z_air, 1.0, GLASS[0], 0),
        "glass": interface(z_glass, GLASS[0], GEL[0], 0),
        "top": interface(z_top, GEL[0], n, SAMPLE_ROUGHNESS, medium_below={"type": "ref", "id": "sample"}),
        "bottom": interface(z_bottom, n, GEL[0], SAMPLE_ROUGHNESS, medium_above={"type": "ref", "id": "sample"}),
        "coat": interface(z_coat, GEL[0], COAT_IOR, BASE_ROUGHNESS),
        "light": half_base(1, args.rho[0]),
        "dark": half_base(-1, args.rho[1]),
        "ring": ring_light(),
        "sensor": {
            "type": "orthographic",
            "near_clip": 0.01,
            "far_clip": 100.0,
            # Looking down with x to the right: the dark side is on the left.
            "to_world": t().look_at(origin=[0, 0, z_air + 1], target=[0, 0, 0], up=[0, 1, 0])
            @ t().scale([args.width / 2, args.width / 2, 1]),
            "film": {
                "type": "hdrfilm",
                "width": args.pixels,
                "height": 1,
                "rfilter": {"type": "box"},
                "pixel_format": "luminance",
            },
            "sampler": {"type": "independent"},
        },
    }


def trace_with_mitsuba(args):
    loaded = mi.load_dict(scene(args))
    measure = math.sin(math.radians(RING_DEG[1])) ** 2 - math.sin(math.radians(RING_DEG[0])) ** 2

    def render(seed, spp):
        return np.array(mi.render(loaded, spp=spp, seed=seed)).reshape(args.pixels) / measure

    render(10_000, 1)  # compile
    begin = time.perf_counter()
    passes = np.stack([render(seed, args.spp) for seed in range(args.passes)])
    seconds = time.perf_counter() - begin
    # Mitsuba's rough dielectric sometimes returns NaN, which spoils a pixel of a pass: such a value is left out.
    spoilt = np.isnan(passes).sum()
    if spoilt:
        print(f"{spoilt} of {passes.size} values of Mitsuba's passes are NaN and left out")
    counts = (~np.isnan(passes)).sum(axis=0)
    return np.nanmean(passes, axis=0), np.nanstd(passes, axis=0, ddof=1) / np.sqrt(counts), seconds


def simulate(args, walks):
    command = [args.farmctl, "simulate", "--walks", walks, "--width", args.width, "--pixels", args.pixels]
    command += ["--sigma-t", args.sigma_t, "--albedo", args.albedo, "--g", args.g, "--thickness", args.thickness]
    command += ["--sample-ior", args.sample_ior, "--rho-light", args.rho[0], "--rho-dark", args.rho[1]]
    begin = time.perf_counter()
    out = subprocess.run([str(c) for c in command], check=True, capture_output=True, text=True).stdout
    seconds = time.perf_counter() - begin
    rows = list(csv.DictReader(io.StringIO(out)))
    return tuple(np.array([float(row[key]) for row in rows]) for key in ("value", "std_error")) + (seconds,)


def main():
    args = parse()
    variant = choose_variant(args.variant)
    values, errors, seconds = trace_with_mitsuba(args)
    ours, our_errors, our_seconds = simulate(args, args.walks)
    # Time is proportional to 1/error², so error² × time does not depend on the duration of the run. Single pixels'
    # errors are noisy: take the mean square over each side.
    half = args.pixels // 2
    sides = (slice(0, half), slice(half, None))

    def noise(value, error):
        return [math.sqrt((error[s] ** 2).mean()) / value[s].mean() for s in sides]

    theirs, mine = noise(values, errors), noise(ours, our_errors)
    smooth = np.concatenate([np.full(half, math.sqrt((errors[s] ** 2).mean())) for s in sides])
    chi2 = ((values - ours) ** 2 / (smooth**2 + our_errors**2)).mean()
    print(f"Mitsuba {mi.__version__} {variant}: {args.spp * args.passes} samples per pixel, {seconds:.2f} s, "
          f"noise {theirs[0]:.2%} dark, {theirs[1]:.2%} light")
    print(f"farmctl: {args.walks} walks, {our_seconds:.2f} s, noise {mine[0]:.2%} dark, {mine[1]:.2%} light")
    print(f"agreement: chi²/n {chi2:.2f}, means of the light side {values[sides[1]].mean():.5f} and "
          f"{ours[sides[1]].mean():.5f}")
    ratios = [(a**2 * seconds) / (b**2 * our_seconds) for a, b in zip(theirs, mine)]
    print(f"time for the same error, Mitsuba over farmctl, one profile of {args.pixels} pixels: "
          f"{ratios[0]:,.0f} dark, {ratios[1]:,.0f} light")


if __name__ == "__main__":
    main()
