#!/usr/bin/env python3
"""How long Mitsuba 3 would take for the paper's dictionary at the errors that its records have.

Renders a random sample of the records, one channel each, and prints for every one the time that Mitsuba needs for the
record's error, and how well the two agree; then the time for all records and channels, with its standard error from the
sample, and how many times that is the time given with --seconds.

    python3 -m venv venv && venv/bin/pip install mitsuba numpy
    cargo build --release && time target/release/farmctl submit
    venv/bin/python tests/mitsuba/dictionary.py --seconds TIME

Mitsuba's LLVM variants need LLVM's library (Debian: libllvm16 or later); without it the scalar variant is used.
"""

import argparse
import csv
import io
import json
import math
import random
import subprocess
from pathlib import Path

import mitsuba as mi
import numpy as np

import compare


def parse():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--name", default="paper", help="dictionary of the paper's scene (default paper)")
    p.add_argument("--data", default="farm-data", help="folder of the farm (default farm-data)")
    p.add_argument("--seconds", type=float, required=True, help="time that the dictionary took")
    p.add_argument("--records", type=int, default=24, help="how many are rendered (default 24)")
    p.add_argument("--seed", type=int, default=1, help="of the choice (default 1)")
    p.add_argument("--spp", type=int, default=128, help="samples per pixel and pass (default 128)")
    p.add_argument("--passes", type=int, default=16, help="independent passes, for the error (default 16)")
    p.add_argument("--farmctl", default=compare.ROOT / "target/release/farmctl")
    p.add_argument("--variant", help="Mitsuba variant (default: llvm_ad_mono, else scalar_rgb)")
    return p.parse_args()


def farmctl(args, *words):
    command = [args.farmctl, "--data", args.data, *words]
    return subprocess.run([str(c) for c in command], check=True, capture_output=True, text=True).stdout


def record(args, medium, channel):
    words = [w for name, v in medium.items() for w in (f"--{name}", v)]
    rows = csv.DictReader(io.StringIO(farmctl(args, "export", args.name, *words)))
    rows = [row for row in rows if row["channel"] == channel]
    return (np.array([float(row[key]) for row in rows]) for key in ("value", "std_error"))


def main():
    args = parse()
    variant = compare.choose_variant(args.variant)
    shown = json.loads(farmctl(args, "show", args.name, "--json"))["data"]
    grid = shown["grid"]
    (ior,) = grid["sample_ior"]
    channels = {c["name"]: (c["rho_light"], c["rho_dark"]) for c in grid["scene"]["channel"]}
    axes = {"sigma-t": "sigma_t_per_mm", "albedo": "albedo", "g": "g", "thickness": "thickness_mm"}
    chance = random.Random(args.seed)
    needed, deviations = [], []
    for _ in range(args.records):
        medium = {name: chance.choice(grid[axis]) for name, axis in axes.items()}
        channel = chance.choice(sorted(channels))
        ours, our_errors = record(args, medium, channel)
        asked = argparse.Namespace(
            sigma_t=medium["sigma-t"], albedo=medium["albedo"], g=medium["g"], thickness=medium["thickness"],
            sample_ior=ior, rho=channels[channel], width=10.0, pixels=len(ours), spp=args.spp, passes=args.passes,
        )
        values, errors, seconds = compare.trace_with_mitsuba(asked)
        half = len(ours) // 2
        ratios, zs = [], []
        for side in (slice(0, half), slice(half, None)):
            theirs, mine = (math.sqrt((e[side] ** 2).mean()) for e in (errors, our_errors))
            ratios.append((theirs / mine) ** 2)
            # A walk serves many pixels, so the errors of farmctl's pixels are correlated; those of Mitsuba's are not.
            mean_error = math.hypot(theirs / math.sqrt(half), mine)
            zs.append((values[side].mean() - ours[side].mean()) / mean_error)
        needed.append(seconds * sum(ratios) / len(ratios))
        deviations += zs
        label = ", ".join(f"{name} {value}" for name, value in medium.items())
        print(f"{label}, {channel}: {needed[-1]:,.0f} s for the same error; z {zs[0]:.2f} dark, {zs[1]:.2f} light", flush=True)
    total = shown["records_total"] * len(channels)
    mean, spread = np.mean(needed), np.std(needed, ddof=1) / math.sqrt(len(needed))
    print(f"Mitsuba {mi.__version__} {variant}, {args.records} records: {mean:.1f} ± {spread:.1f} s each; "
          f"greatest |z| {max(map(abs, deviations)):.1f}")
    print(f"all {total:,} profiles: {mean * total / 86400:,.1f} ± {spread * total / 86400:,.1f} days, "
          f"{mean * total / args.seconds:,.0f} ± {spread * total / args.seconds:,.0f} times {args.seconds} s")


if __name__ == "__main__":
    main()
