#!/usr/bin/env python3
"""Load the media that farmctl writes for Mitsuba 3 with Mitsuba 3, and check that they say what was measured.

Asks the loaded media for their coefficients and g, and compares them with the measured values. A pbrt file is not
loaded but read by pbrt's rules, which needs no pbrt.

    python3 -m venv venv && venv/bin/pip install mitsuba
    farmctl measure examples/white.csv --mu 1 --g 0.4 -o media --json > measured.json
    venv/bin/python tests/mitsuba/media.py --expected measured.json --dict media/media.py --xml media/media.xml \\
        --pbrt media/media.pbrt

The measured values are what `farmctl measure --json` prints or a list of materials, in the order of the files:

    [{"material": "Clear resin", "g": 0.4,
      "channels": [{"channel": "R", "sigma_t_per_mm": 6.0, "albedo": 0.9991, "g": 0.4}, …]}, …]
"""

import argparse
import ast
import json
import re
import sys
from pathlib import Path
from xml.etree import ElementTree

import mitsuba as mi

# A few roundings in the single precision of Mitsuba and pbrt.
TOLERANCE = 3e-7
RENDERED_NM = (360.0, 830.0)


def parse():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--expected", type=Path, required=True, help="JSON file with the measured values")
    p.add_argument("--dict", type=Path, required=True, help="Python file with `media = {…}`")
    p.add_argument("--xml", type=Path, help="XML file with a scene of <medium> elements")
    p.add_argument("--pbrt", type=Path, help="pbrt file with MakeNamedMedium statements")
    return p.parse_args()


def read_expected(path):
    """The measured values, from a list or from the output of `farmctl measure --json`."""
    measured = json.loads(path.read_text(encoding="utf-8"))
    if isinstance(measured, list):
        return measured
    best = {}
    for material in measured["data"]["materials"]:
        refined = [(c["channel"], c["refined"]) for c in material["channels"] if c["refined"]]
        values = ("sigma_t_per_mm", "albedo", "g")
        best[material["material"]] = [{"channel": name, **{key: b[key] for key in values}} for name, b in refined]
    return [{"material": name, "channels": channels} for name, channels in best.items() if channels]


def read_dict(path):
    """The assigned literal, without running the file."""
    (statement,) = ast.parse(path.read_text(encoding="utf-8")).body
    assert isinstance(statement, ast.Assign) and statement.targets[0].id == "media"
    assert len(statement.value.keys) == len({key.value for key in statement.value.keys}), "a name occurs twice"
    return ast.literal_eval(statement.value)


def probe(wavelength_nm=None):
    interaction = mi.MediumInteraction3f()
    if wavelength_nm is not None:
        interaction.wavelengths = [wavelength_nm] * 4
    return interaction


class Loaded:
    """A medium of Mitsuba, with the coefficients that a walk would meet in it."""

    def __init__(self, medium):
        self.medium = medium
        self.name = medium.id()
        self.g = mi.traverse(medium)["phase_function.g"]

    def at(self, wavelength_nm=None):
        """σ_t and σ_s, by channel or of one wavelength."""
        sigma_s, _, sigma_t = self.medium.get_scattering_coefficients(probe(wavelength_nm))
        return list(sigma_t), list(sigma_s)


def load(source):
    """The media of a dictionary, or of a file that a scene includes, each inside of a shape that refers to its name."""
    if isinstance(source, dict):
        shapes = {
            f"shape of {name}": {"type": "sphere", "interior": {"type": "ref", "id": name}} for name in source
        }
        scene = mi.load_dict({"type": "scene", **source, **shapes})
        names = list(source)
    else:
        assert mi.load_file(str(source)).shapes() == [], "it loads by itself, and holds nothing but media"
        names = [medium.get("id") for medium in xml_media(source)]
        shapes = "".join(f'<shape type="sphere"><ref name="interior" id="{name}"/></shape>' for name in names)
        include = f'<include filename="{source.resolve()}"/>'
        scene = mi.load_string(f'<scene version="3.0.0">\n{include}\n{shapes}</scene>')
    loaded = {medium.name: medium for medium in (Loaded(s.interior_medium()) for s in scene.shapes())}
    assert len(loaded) == len(names) == len(set(names)), "a name occurs twice"
    return [loaded[name] for name in names]


def xml_media(path):
    """The elements of the only root; the parser is stricter than Mitsuba's, for example about comments."""
    root = ElementTree.parse(path).getroot()
    assert root.tag == "scene" and all(child.tag == "medium" for child in root), "a scene of media"
    return list(root)


def kinds(source):
    """The kind of each medium: rgb, spectrum or scalar."""
    if isinstance(source, dict):
        return [m["sigma_t"]["type"] if isinstance(m["sigma_t"], dict) else "scalar" for m in source.values()]
    tags = [medium.find("*[@name='sigma_t']").tag for medium in xml_media(source)]
    return ["scalar" if tag == "float" else tag for tag in tags]


class Check:
    def __init__(self):
        self.count = 0
        self.failures = []

    def close(self, what, got, wanted):
        self.count += 1
        if not abs(got - wanted) <= TOLERANCE * abs(wanted):
            self.failures.append(f"{what}: {got!r}, not {wanted!r}")

    def coefficients(self, what, got, channel):
        sigma_t, sigma_s = got
        self.close(f"{what}: sigma_t", sigma_t, channel["sigma_t_per_mm"])
        if sigma_t > 0:
            self.close(f"{what}: albedo", sigma_s / sigma_t, channel["albedo"])

    def equal(self, what, got, wanted):
        self.count += 1
        if got != wanted:
            self.failures.append(f"{what}: {got!r}, not {wanted!r}")


def walk(kind_of_each, materials):
    """For each medium its kind and the channels that it must hold."""
    kind_of_each = iter(kind_of_each)
    for material in materials:
        kind = next(kind_of_each)
        channels = material["channels"]
        if kind == "scalar":
            for i, channel in enumerate(channels):
                if i > 0:
                    assert next(kind_of_each) == "scalar"
                yield kind, [channel]
        elif kind == "rgb":
            yield kind, sorted(channels, key=lambda c: "RGB".index(c["channel"]))
        else:
            yield kind, sorted(channels, key=lambda c: float(c["channel"]))
    assert next(kind_of_each, None) is None, "more media than were measured"


def wavelengths(channels):
    """Each measured wavelength with its channel, and the ends of the spectrum, where the outer channels continue."""
    pairs = [(float(c["channel"]), c) for c in channels]
    return [(min(RENDERED_NM[0], pairs[0][0]), channels[0]), *pairs, (max(RENDERED_NM[1], pairs[-1][0]), channels[-1])]


def check_mitsuba(check, label, source, materials):
    """Checks rgb in an RGB variant, spectra in a spectral one, scalars in both; rgb must at least load in both."""
    for variant in ("scalar_rgb", "scalar_spectral"):
        mi.set_variant(variant)
        spectral = variant == "scalar_spectral"
        for medium, (kind, channels) in zip(load(source), walk(kinds(source), materials), strict=True):
            what = f"{label}, {variant}, {medium.name}"
            if kind != "spectrum" or spectral:
                check.close(f"{what}: g", medium.g, channels[0]["g"])
            if kind == "scalar":
                for nm in (None,) if not spectral else (400.0, 700.0):
                    sigma_t, sigma_s = medium.at(nm)
                    check.coefficients(what, (sigma_t[0], sigma_s[0]), channels[0])
            elif kind == "rgb" and not spectral:
                sigma_t, sigma_s = medium.at()
                for i, channel in enumerate(channels):
                    check.coefficients(f"{what} {channel['channel']}", (sigma_t[i], sigma_s[i]), channel)
            elif kind == "rgb":
                # Mitsuba's conversion of a colour is not checked, but the result must be within the range of the
                # channels or near it, unlike with a wrong scale or values cut off at 1.
                greatest = max(c["sigma_t_per_mm"] for c in channels)
                peak = max(medium.at(float(nm))[0][0] for nm in range(400, 701, 10))
                check.equal(f"{what}: greatest sigma_t {peak}, for {greatest}", 0.5 < peak / greatest < 10, True)
            elif spectral:
                for nm, channel in wavelengths(channels):
                    sigma_t, sigma_s = medium.at(nm)
                    check.coefficients(f"{what} {nm:g} nm", (sigma_t[0], sigma_s[0]), channel)


TOKEN = re.compile(r'\s*(?:#[^\r\n]*|("(?:[^"\\\n]|\\.)*")|(\[|\])|([^\s"\[\]#][^\s"\[\]]*))')


def read_pbrt(path):
    """The statements of a file: name and parameters, each with its type."""
    text = path.read_text(encoding="utf-8").rstrip()
    tokens, at = [], 0
    while at < len(text):
        match = TOKEN.match(text, at)
        assert match, f"no token at {text[at:at + 40]!r}"
        tokens += [token for token in match.groups() if token]
        at = match.end()
    statements, i = [], 0
    while i < len(tokens):
        assert tokens[i] == "MakeNamedMedium", tokens[i]
        name, parameters = json.loads(tokens[i + 1]), {}
        i += 2
        while i < len(tokens) and tokens[i].startswith('"'):
            kind, parameter = json.loads(tokens[i]).split()
            end = tokens.index("]", i) if tokens[i + 1] == "[" else i + 1
            values = tokens[i + 2 : end] if tokens[i + 1] == "[" else [tokens[i + 1]]
            assert parameter not in parameters, f"{name}: {parameter} occurs twice"
            parameters[parameter] = (kind, [json.loads(value) for value in values])
            i = end + 1
        statements.append((name, parameters))
    assert len(statements) == len({name for name, _ in statements}), "a name occurs twice"
    return statements


def interpolate(pairs, nm):
    for (a, x), (b, y) in zip(pairs, pairs[1:]):
        if a <= nm <= b:
            return x + (y - x) * (nm - a) / (b - a)
    return 0.0


def check_pbrt(check, statements, kind_of_each, materials):
    expected = walk(kind_of_each, materials)
    for (name, parameters), (kind, channels) in zip(statements, expected, strict=True):
        what = f"pbrt, {name}"
        check.equal(f"{what}: parameters", sorted(parameters), ["g", "scale", "sigma_a", "sigma_s", "type"])
        check.equal(f"{what}: type", parameters["type"], ("string", ["homogeneous"]))
        check.equal(f"{what}: scale", parameters["scale"], ("float", [1.0]))
        check.equal(f"{what}: g", parameters["g"], ("float", [channels[0]["g"]]))
        (type_a, sigma_a), (type_s, sigma_s) = parameters["sigma_a"], parameters["sigma_s"]
        wanted_type = "rgb" if kind == "rgb" else "spectrum"
        check.equal(f"{what}: types", (type_a, type_s), (wanted_type, wanted_type))
        if kind == "rgb":
            samples = list(zip(channels, sigma_a, sigma_s, strict=True))
        else:
            spectra = [list(zip(values[::2], values[1::2], strict=True)) for values in (sigma_a, sigma_s)]
            for spectrum in spectra:
                nm = [pair[0] for pair in spectrum]
                check.equal(f"{what}: wavelengths increase", nm, sorted(set(nm)))
            at = wavelengths(channels) if kind == "spectrum" else [(nm, channels[0]) for nm in RENDERED_NM]
            samples = [(c, interpolate(spectra[0], nm), interpolate(spectra[1], nm)) for nm, c in at]
        for channel, a, s in samples:
            sigma_t, albedo = channel["sigma_t_per_mm"], channel["albedo"]
            check.close(f"{what}: sigma_a", a, sigma_t * (1 - albedo))
            check.close(f"{what}: sigma_s", s, sigma_t * albedo)


def main():
    args = parse()
    check = Check()
    materials = read_expected(args.expected)
    source = read_dict(args.dict)
    check_mitsuba(check, "dictionary", source, materials)
    if args.xml:
        check_mitsuba(check, "XML", args.xml, materials)
        check.equal("kinds", kinds(args.xml), kinds(source))
    if args.pbrt:
        # pbrt's text does not distinguish scalars from spectra, the dictionary does.
        check_pbrt(check, read_pbrt(args.pbrt), kinds(source), materials)
    for failure in check.failures:
        print(failure)
    print(f"Mitsuba {mi.__version__}: {check.count} checks, {len(check.failures)} failures")
    return bool(check.failures)


if __name__ == "__main__":
    sys.exit(main())
