"""Answers have the numbers of farmctl, and readable forms."""

import dataclasses
import io
import json
import pathlib
import subprocess
import warnings
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import pyarrow
import pytest
import xarray as xr

import resin_farm
from conftest import WHITE
from resin_farm import _decode, _programs
from resin_farm._wire import fits_pb2, model_pb2

Array: TypeAlias = np.typing.NDArray[np.float64]


def farmctl(farm: resin_farm.Farm, *arguments: str) -> dict[str, Any]:
    return _programs.farmctl(["--server", farm.address, *arguments])


def same(a: object, b: object, where: str = "") -> None:
    """Asserts equality to the last bit."""
    if isinstance(a, tuple | list):
        assert isinstance(b, tuple | list) and len(a) == len(b), where
        for i, (x, y) in enumerate(zip(a, b, strict=True)):
            same(x, y, f"{where}[{i}]")
    elif isinstance(a, np.ndarray):
        np.testing.assert_array_equal(a, b, where)
    elif hasattr(a, "__dataclass_fields__"):
        for name in (name for name in a.__dataclass_fields__ if not name.startswith("_")):
            same(getattr(a, name), getattr(b, name), f"{where}.{name}")
    else:
        assert a == b, where


def test_a_measurement_is_what_farmctl_measures(farm: resin_farm.Farm) -> None:
    measured = farm.measure(WHITE)
    same(measured, _decode.measured_of_json(farmctl(farm, "measure", str(WHITE))))
    held = farm.measure(WHITE, mu=1.0, g=0.4)
    same(held, _decode.measured_of_json(farmctl(farm, "measure", str(WHITE), "--mu", "1", "--g", "0.4")))
    assert held["white"]["R"].refined is not None
    assert held["white"]["R"].refined.medium.sigma_t_per_mm == pytest.approx(6.0, rel=0.03)
    assert held["white"]["R"].refined.g.is_closed and str(held["white"]["R"].refined.g) == "held"


@pytest.mark.parametrize(
    ("given", "options"),
    [
        ({"g": 0.4}, ["--g", "0.4"]),
        (
            {"sigma_t_per_mm": (None, 9.0), "objective": "paper", "lambda_": 10.0},
            ["--sigma-t", "..9", "--objective", "paper", "--lambda", "10"],
        ),
        (
            {"phase": "henyey_greenstein", "g": 0.4},
            ["--phase", "hg", "--g", "0.4"],
        ),
        (
            {"top": 2, "blur_mm": 0.02, "wavelet": "haar", "level": 3},
            ["--top", "2", "--blur-mm", "0.02", "--wavelet", "haar", "--level", "3"],
        ),
    ],
)
def test_a_fit_is_what_farmctl_fits(farm: resin_farm.Farm, given: resin_farm.FitOptions, options: list[str]) -> None:
    found = farmctl(farm, "fit", str(WHITE), *options)
    same(farm.fit(WHITE, **given), _decode.material_of_json(found["materials"][0], found["assumed"]))


def test_an_output_has_the_files_and_the_same_answer(
    farm: resin_farm.Farm, white: resin_farm.Measurement, tmp_path: pathlib.Path
) -> None:
    """Every option reaches farmctl, and those that it lacks are refused."""
    given: resin_farm.FitOptions = {
        "sigma_t_per_mm": (None, 28.0), "albedo": (0.99, None), "g": 0.4, "mu": 1.0, "mu_std_error": 0.01,
        "phase": "henyey_greenstein", "blur_mm": 0.01, "thickness_std_error_mm": 0.002,
    }  # fmt: skip
    same(farm.measure(white, output=tmp_path / "media", **given), farm.measure(white, **given))
    names = {path.name for path in (tmp_path / "media").iterdir()}
    assert {"table.csv", "media.json", "media.py", "media.pbrt", "media_blender.py", "answer.json"} <= names
    free = farm.measure(white, free_g=True, mu=1.0, objective="likelihood")
    same(farm.measure(white, output=tmp_path / "free", free_g=True, mu=1.0, objective="likelihood"), free)
    with pytest.raises(resin_farm.FarmError, match="records of the dictionary without intervals"):
        farm.measure(white, output=tmp_path / "other", objective="paper", lambda_=10.0, wavelet="haar", level=3)
    with pytest.raises(TypeError, match="curves, top: options with an output are"):
        farm.measure(white, output=tmp_path / "other", top=3, curves=True)
    assert not (tmp_path / "other").exists()


def of_laboratory() -> resin_farm.Measurement:
    """Simulated slabs in the scene `lab`, where the second lobe has a weight of 0.05 and an anisotropy of −0.5."""
    slabs = [
        resin_farm.simulate(sigma_t_per_mm=6, albedo=0.995, g=0.35, thickness_mm=thickness, walks=20_000)
        for thickness in (0.5, 1)
    ]
    profiles = [
        resin_farm.MeasuredProfile(channel, slab.thickness_mm, slab.x_mm, values, slab.std_errors[channel])
        for slab in slabs
        for channel, values in slab.channels.items()
    ]
    return resin_farm.Measurement("grey", profiles)


def test_a_second_lobe_is_what_farmctl_estimates(tmp_path: pathlib.Path) -> None:
    """One weight for all channels, one for each, and none."""
    grey, file = of_laboratory(), tmp_path / "grey.csv"
    grey.to_pandas().to_csv(file, index=False)
    grid = resin_farm.Grid(
        sigma_t_per_mm=[4, 6, 8],
        albedo=[0.99, 0.995, 0.999],
        g=[0.3, 0.4],
        thickness_mm=[0.5, 1],
        scene="lab",
        walks=5000,
    )
    with resin_farm.Farm(tmp_path / "farm") as farm:
        farm.submit(grid, progress=False)
        found = {
            "two-lobes": farm.measure(file, mu=1.0, g=0.35, phase="two_lobes"),
            "per-channel": farm.measure(file, mu=1.0, g=0.35, phase="per_channel"),
            "hg": farm.measure(file, mu=1.0, g=0.35, phase="henyey_greenstein"),
        }
        for phase, measured in found.items():
            arguments = ["measure", str(file), "--mu", "1", "--g", "0.35", "--phase", phase]
            same(measured, _decode.measured_of_json(farmctl(farm, *arguments)))
    for phase, scope in (("two-lobes", "material"), ("per-channel", "channel")):
        for fit in found[phase]["grey"].channels:
            assert fit.refined is not None and fit.second_lobe is not None
            scene = fit.refined.likelihood.scene
            (weight,) = (estimate for estimate in scene if estimate.quantity == "sample second lobe weight")
            assert weight.scope == scope and weight.std_error < weight.prior_std_error
            assert fit.second_lobe.g == -0.5
            assert abs(fit.second_lobe.weight - weight.value) < weight.std_error
    shared = {fit.second_lobe for fit in found["two-lobes"]["grey"].channels}
    assert len(shared) == 1
    frame = found["two-lobes"].to_pandas()
    assert frame["second_lobe_weight"].between(0, 0.5).all() and frame["second_lobe_g"].eq(-0.5).all()
    assert found["hg"].to_pandas()["second_lobe_weight"].isna().all()
    assert found["hg"]["grey"].to_mitsuba()["phase"] == {"type": "hg", "g": 0.35}


def test_two_lobes_are_a_blend_for_mitsuba() -> None:
    """Its weight is that of the second lobe, and the first has the anisotropy with which the mean cosine is g."""

    def fit(*weights: float) -> resin_farm.MaterialFit:
        best = fits_pb2.Candidate(medium=model_pb2.Medium(sigma_t_per_mm=6, albedo=0.99, g=0.4))
        channels = [
            fits_pb2.ChannelFit(
                channel=channel,
                refined=fits_pb2.Refined(
                    best=best, covariance=[0.0] * 9, second_lobe=model_pb2.SecondLobe(weight=weight, g=-0.5)
                ),
            )
            for channel, weight in zip("RGB", weights, strict=True)
        ]
        return _decode.material_fit(fits_pb2.MaterialFit(material="grey", channels=channels))

    assert fit(0.2, 0.2, 0.2).to_mitsuba()["phase"] == {
        "type": "blendphase",
        "weight": 0.2,
        "first": {"type": "hg", "g": 0.625},
        "second": {"type": "hg", "g": -0.5},
    }
    with pytest.raises(ValueError, match=r"their weights are 0\.2, 0\.1, 0\.2"):
        fit(0.2, 0.1, 0.2).to_mitsuba()


def test_fits_say_what_is_wrong(farm: resin_farm.Farm, white: resin_farm.Measurement) -> None:
    with pytest.raises(resin_farm.InvalidArgument, match="albedo") as caught:
        farm.fit(white, albedo=2.0)
    assert list(caught.value.fields) == ["options.albedo"]
    with pytest.raises(TypeError, match="anisotropy: options are"):
        farm.fit(white, anisotropy=0.4)  # type: ignore[call-arg]
    with pytest.raises(ValueError, match="allowed are paper, likelihood"):
        farm.fit(white, objective="least")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="allowed are two_lobes, per_channel, henyey_greenstein"):
        farm.fit(white, phase="hg")  # type: ignore[arg-type]
    with pytest.raises(resin_farm.InvalidArgument, match="no second lobe of uncertain weight"):
        farm.fit(white, phase="per_channel")
    with pytest.raises(resin_farm.InvalidArgument, match="phase") as caught:
        farm.fit(white, objective="paper", phase="henyey_greenstein")
    assert list(caught.value.fields) == ["options.phase"]
    with pytest.raises(resin_farm.NotFound, match="nothing"):
        farm.fit(white, "nothing")
    other = resin_farm.Measurement("other", white.profiles)
    frame = pd.concat([white.to_pandas(), other.to_pandas()])
    with (
        pytest.warns(resin_farm.MeasurementWarning, match="SAME_VALUES"),
        pytest.raises(resin_farm.InvalidArgument, match="white, other"),
    ):
        farm.fit(frame)
    falling = resin_farm.MeasuredProfile("R", 0.5, [3, 2, 1], [0.1, 0.2, 0.3])
    with pytest.raises(resin_farm.InvalidArgument, match=r"the measurement: .*falling"):
        farm.fit(resin_farm.Measurement("falling", [falling]))
    with pytest.raises(resin_farm.InvalidArgument, match="one for each of the 3 pixels"):
        resin_farm.MeasuredProfile("R", 0.5, [3, 2, 1], [0.1, 0.2])


def with_values(measurement: resin_farm.Measurement, change: Callable[[Array], Array]) -> resin_farm.Measurement:
    profiles = [
        resin_farm.MeasuredProfile(p.channel, p.thickness_mm, p.x_mm, change(p.values)) for p in measurement.profiles
    ]
    return resin_farm.Measurement("white", profiles)


def test_numbers_in_memory_are_checked_as_files_are(farm: resin_farm.Farm, white: resin_farm.Measurement) -> None:
    per_cent = with_values(white, lambda v: 100 * v)
    with pytest.raises(resin_farm.InvalidArgument, match=r"per cent|%"):
        farm.measure(per_cent)
    eight_bit = with_values(white, lambda v: np.round(255 * v) / 255)
    with pytest.warns(resin_farm.MeasurementWarning, match="EIGHT_BIT"):
        farm.fit(eight_bit, g=0.4)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        farm.fit(eight_bit, g=0.4)
    too_bright = with_values(white, lambda v: 1.1 * v)
    fit = farm.fit(too_bright, g=0.4)
    assert any("χ²" in remark or "brighter" in remark for remark in fit.remarks), fit.remarks
    assert fit.remarks[0] in str(fit) and "<p>white" in fit._repr_html_()
    paper = farm.fit(white, g=0.4, objective="paper")
    assert "assumed" not in str(paper), "the paper's distance assumes nothing"
    assert "assumed: thickness_std_error_mm" in str(farm.fit(white, g=0.4))


def test_media_are_arrays_over_wavelength(farm: resin_farm.Farm, white: resin_farm.Measurement) -> None:
    """Rising wavelengths for channels that are wavelengths, and the order of the channels for others."""
    measured = farm.measure([white], g=0.4)
    arrays = measured.to_xarray()
    assert list(arrays["channel"].values) == ["R", "G", "B"]
    names = {"R": "630 nm", "G": "550", "B": "470 nm"}
    (fit,) = measured.materials
    channels = tuple(dataclasses.replace(channel, channel=names[channel.channel]) for channel in fit.channels)
    spectral = dataclasses.replace(measured, materials=(dataclasses.replace(fit, channels=channels),))
    arrays = spectral.to_xarray()
    assert list(arrays["wavelength_nm"].values) == [470, 550, 630]
    found = arrays["sigma_t_per_mm_low"].sel(material="white", wavelength_nm=630).item()
    assert fit["R"].refined is not None and found == fit["R"].refined.sigma_t_per_mm.low


def test_files_and_frames_are_the_same_measurement(white: resin_farm.Measurement, tmp_path: pathlib.Path) -> None:
    frame = white.to_pandas()
    for table in (frame, pyarrow.Table.from_pandas(frame)):
        (again,) = resin_farm.Measurement.from_pandas(table)
        same(again, white)
    known = [
        resin_farm.MeasuredProfile(
            p.channel, p.thickness_mm, p.x_mm, p.values, np.full(p.values.shape, 0.01), origin_mm=0.1
        )
        for p in white.profiles
    ]
    complete = resin_farm.Measurement("complete", known)
    complete.to_pandas().to_csv(tmp_path / "complete.csv", index=False)
    same(resin_farm.read_measurements(tmp_path / "complete.csv"), [complete])
    assert complete.profiles[0].set_up == {"origin_mm": 0.1}
    (tmp_path / "bad.csv").write_text("material,channel,x_mm,value\n", encoding="utf-8")
    with pytest.raises(resin_farm.InvalidArgument, match="thickness_mm"):
        resin_farm.read_measurements(tmp_path / "bad.csv")
    with pytest.raises(TypeError, match="haze"):
        resin_farm.MeasuredProfile("R", 1, [0], [0], haze=1)


def test_a_dictionary_as_an_array_has_the_records(farm: resin_farm.Farm) -> None:
    dictionary = farm.dictionary()
    dataset = dictionary.to_xarray()
    assert dict(dataset.sizes) == {
        "sample_ior": 1,
        "sigma_t_per_mm": 9,
        "g": 2,
        "thickness_mm": 2,
        "albedo": 4,
        "channel": 3,
        "x_mm": 360,
    }
    assert dataset.attrs["records_digest"] == dictionary.records_digest
    # Compared with the records that farmctl prints.
    command = [_programs.program("farmctl"), "--server", farm.address, "--quiet", "export", dictionary.name]
    records = pd.read_csv(
        io.StringIO(subprocess.run(command, check=True, capture_output=True, encoding="utf-8").stdout)
    )
    by = ["sample_ior", "sigma_t_per_mm", "g", "thickness_mm", "albedo", "channel", "x_mm"]
    exported = xr.Dataset.from_dataframe(records.set_index(by)[["value", "std_error"]]).sel(channel=["R", "G", "B"])
    for name in ("value", "std_error"):
        np.testing.assert_array_equal(exported[name].values.astype(np.float32), dataset[name].values)
    at = {"sigma_t_per_mm": 6, "albedo": 0.999, "g": 0.4, "thickness_mm": 0.5}
    profile = dictionary.profile(sigma_t_per_mm=6, albedo=0.999, g=0.4, thickness_mm=0.5)
    assert profile.recorded
    # The profile comes from the model between the records, which does not follow the noise of each record.
    record = dataset["value"].sel(at, method="nearest").isel(sample_ior=0)
    np.testing.assert_allclose(profile["G"], record.sel(channel="G"), atol=0.01)
    options = "profile --sigma-t 6 --albedo 0.999 --g 0.4 --thickness 0.5 --channel G".split()
    expected = farmctl(farm, *options)
    np.testing.assert_array_equal(profile["G"], expected["channels"][0]["values"])
    np.testing.assert_allclose(profile.x_mm, dataset["x_mm"], atol=1e-12)
    between = dictionary.profile(sigma_t_per_mm=6.5, albedo=0.9992, g=0.35, thickness_mm=0.5, channels=("R",))
    assert not between.recorded and list(between.channels) == ["R"]


def test_a_simulation_is_that_of_farmctl(farm: resin_farm.Farm) -> None:
    options = {"sigma_t_per_mm": 6.0, "albedo": 0.99, "g": -0.4, "thickness_mm": 0.5, "walks": 5000}
    profile = farm.simulate(**options)  # type: ignore[arg-type]
    frame = profile.to_pandas()
    command = "simulate --sigma-t 6 --albedo 0.99 --g=-0.4 --thickness 0.5 --walks 5000".split()
    ran = subprocess.run([_programs.program("farmctl"), *command], check=True, capture_output=True, encoding="utf-8")
    expected = pd.read_csv(io.StringIO(ran.stdout))
    np.testing.assert_array_equal(frame["value"].astype(np.float32), expected["value"].astype(np.float32))
    with pytest.raises(resin_farm.InvalidArgument, match=r"albedo = 1\.5 is not valid") as wrong:
        resin_farm.simulate(sigma_t_per_mm=1, albedo=1.5, g=0, thickness_mm=1)
    assert list(wrong.value.fields) == ["albedo"]


def test_similar_media(farm: resin_farm.Farm) -> None:
    medium = resin_farm.Medium(6, 0.9991, 0.4)
    found = farm.similar(medium, [0.0, 0.4])
    assert found[1] == medium
    assert found[0].reduced_scattering_per_mm == pytest.approx(medium.reduced_scattering_per_mm, rel=1e-9)


def test_answers_show_themselves(farm: resin_farm.Farm, white: resin_farm.Measurement) -> None:
    import matplotlib

    matplotlib.use("Agg")
    measured = farm.measure(white, mu=1.0)
    assert str(measured).startswith("scale factor μ = 1.000 ± 0.000, given; anisotropy g = ")
    assert "<td>white</td><td>R</td>" in measured._repr_html_()
    frame = measured.to_pandas()
    assert list(frame["channel"]) == ["R", "G", "B"] and frame["sigma_t_per_mm"].gt(0).all()
    fit = farm.fit(white, g=0.4, curves=True)
    shown = [fit, white, farm.dictionary().profile(sigma_t_per_mm=6, albedo=0.999, g=0.4, thickness_mm=0.5)]
    for figure in (one.plot() for one in shown):  # type: ignore[attr-defined]
        picture = io.BytesIO()
        figure.savefig(picture)
        assert picture.getvalue().startswith(b"\x89PNG")
    with pytest.raises(ValueError, match="curves=True"):
        farm.fit(white, g=0.4).plot()
    for one in (farm, farm.dictionary(), white, fit):
        assert one._repr_html_().startswith("<table")
    unrefined = farm.fit(white, refine=False)
    assert unrefined["R"].refined is None and "white" in str(unrefined)
    assert json.loads(unrefined.to_pandas().to_json())["misfit"]["0"] is None
    with pytest.raises(KeyError, match="the channels are R, G, B"):
        fit["X"]


def test_maps_and_designs_are_those_of_farmctl(farm: resin_farm.Farm, white: resin_farm.Measurement) -> None:
    import matplotlib

    matplotlib.use("Agg")
    answer = farmctl(farm, "map", str(WHITE))
    for found, expected in zip(farm.map(white), answer["maps"], strict=True):
        assert found.channel == expected["channel"] and found.errors.shape == (2, 9, 4)
        np.testing.assert_array_equal(found.errors.ravel(), np.ravel([layer["errors"] for layer in expected["layers"]]))
        assert found.plot().axes
    medium = resin_farm.Medium(6, 0.999, 0.4)
    design = farm.design(medium, slabs_mm=[[0.5, 1], [0.5]], shots=[1, 4])
    expected = farmctl(farm, *"design --sigma-t 6 --albedo 0.999 --g 0.4 --slabs 0.5,1 --slabs 0.5 --shots 1,4".split())
    assert [one.slabs_mm for one in design] == [tuple(one["slabs_mm"]) for one in expected["sets"]]
    assert [one.g_held.albedo for one in design] == [one["g_held"]["albedo"] for one in expected["sets"]]
    assert design.best.slabs_mm == (0.5, 1.0) and "best" in design._repr_html_()
    assert design.to_pandas()["sigma_t_share"].gt(0).all()
    with pytest.raises(resin_farm.InvalidArgument, match=r"^slabs_mm\[0\]\[0\] = 5 is not valid") as caught:
        farm.design(medium, slabs_mm=[[5]])
    assert list(caught.value.fields) == ["slabs_mm[0][0]"]


def test_the_scale_factor_is_found_with_its_curve(farm: resin_farm.Farm) -> None:
    scale = farm.measure(WHITE, objective="paper").scale
    assert scale is not None and scale.mu[scale.error.argmin()] == pytest.approx(scale.best_mu)
    assert scale.plot().axes


def test_a_medium_for_mitsuba_is_what_farmctl_writes(farm: resin_farm.Farm, tmp_path: pathlib.Path) -> None:
    farmctl(farm, "measure", str(WHITE), "--mu", "1", "--g", "0.4", "-o", str(tmp_path / "media"))
    written: dict[str, Any] = {}
    exec((tmp_path / "media" / "media.py").read_text(encoding="utf-8"), written)
    measured = farm.measure(WHITE, mu=1.0, g=0.4)["white"]
    assert measured.to_mitsuba() == written["media"]["white"]
    assert measured["R"].refined is not None
    other = dataclasses.replace(measured["R"].refined.medium, g=0.5)
    red = dataclasses.replace(measured["R"], refined=dataclasses.replace(measured["R"].refined, medium=other))
    with pytest.raises(ValueError, match="one g is needed"):
        dataclasses.replace(measured, channels=(red, *measured.channels[1:])).to_mitsuba()
