"""Short forms of all public objects, and their tables in notebooks."""

import dataclasses
import html.parser
import inspect
from collections.abc import Iterator

import pytest

import resin_farm
from conftest import WHITE

LONGEST = 240
# Classes that no object of an answer has.
WITHOUT = {"Capture", "FitOptions", "MeasurementWarning"}


def parts(thing: object) -> Iterator[object]:
    """An object of this package, and those that it contains."""
    if type(thing).__module__.startswith("resin_farm"):
        yield thing
        if dataclasses.is_dataclass(thing):
            for field in dataclasses.fields(thing):
                yield from parts(getattr(thing, field.name))
    elif isinstance(thing, list | tuple):
        for one in thing:
            yield from parts(one)


@pytest.fixture(scope="module")
def answers(
    farm: resin_farm.Farm, white: resin_farm.Measurement, tmp_path_factory: pytest.TempPathFactory
) -> list[object]:
    folder = tmp_path_factory.mktemp("media")
    farm.measure(WHITE, "grid", mu=1.0, output=folder)
    medium = resin_farm.Medium(6, 0.999, 0.4)
    lobe = resin_farm.SecondLobe(0.05, -0.5)
    estimate = resin_farm.SceneEstimate(
        "gel thickness", "mm", "slab", 0.5, 0.0512345678, 0.00123456, 0.05, 0.01, at_end=False
    )
    return [
        *(farm, farm.dictionary(), medium, lobe, estimate, white),
        *(resin_farm.Grid(), resin_farm.Grid(g=[i / 40 for i in range(40)], scene="lab")),
        *(farm.measure(WHITE, objective="paper"), farm.measure(WHITE, mu=1.0), farm.fit(white, refine=False)),
        *(farm.fit(white, curves=True), *farm.map(white), farm.design(medium)),
        farm.dictionary().profile(sigma_t_per_mm=6, albedo=0.999, g=0.4, thickness_mm=0.5),
        resin_farm.predict(folder, ["white:1"], over=["black", 0.9], geometry="45:0", roughness=0),
        resin_farm.PrintColour("white", (81.234, -1.234, 3.456), (0.5, 0.01, 0.02), (200, 200, 190)),
    ]


def test_short_forms_fit_on_a_line_or_two(answers: list[object]) -> None:
    found = list(parts(answers))
    for one in found:
        assert len(repr(one)) <= LONGEST and "\n" not in repr(one) and "array(" not in repr(one), repr(one)
    classes = {name for name in resin_farm.__all__ if inspect.isclass(getattr(resin_farm, name))}
    errors = {name for name in classes if issubclass(getattr(resin_farm, name), Exception)}
    assert {type(one).__name__ for one in found} == classes - errors - WITHOUT


def test_short_forms_have_the_numbers(farm: resin_farm.Farm, white: resin_farm.Measurement) -> None:
    fit = farm.fit(white, g=0.4)
    refined = fit["R"].refined
    assert refined is not None
    assert f"R {fit['R'].medium.sigma_t_per_mm:.3g} ({refined.sigma_t_per_mm})" in repr(fit)
    assert repr(white) == "<Measurement white: R, G, B; slabs of 0.5, 1 mm>"
    assert repr(white.profiles[0]).startswith("<MeasuredProfile R, 0.5 mm: 180 pixels from -4.97 to 4.97 mm")
    bands = [f"{nm} nm" for nm in range(400, 710, 10)]
    wide = dataclasses.replace(fit, channels=tuple(dataclasses.replace(fit["R"], channel=band) for band in bands))
    assert "400 nm" in repr(wide) and "(31)" in repr(wide) and len(repr(wide)) < LONGEST
    medium = resin_farm.Medium(6, 0.9991, 0.4)
    assert eval(repr(medium), vars(resin_farm)) == medium and str(medium) == "σ_t 6 /mm, α 0.999100, g 0.4"
    grid = resin_farm.Grid(g=[0.3, 0.4], walks=5000)
    assert eval(repr(grid), vars(resin_farm)) == grid


class Page(html.parser.HTMLParser):
    """Checks that tags are plain and closed."""

    ALLOWED = frozenset("table caption thead tbody tr th td p span a".split())

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert tag in self.ALLOWED and {name for name, _ in attrs} <= {"style", "href"}, tag
        # Notebooks choose the colours of text, also in the dark.
        assert not any(name == "style" and (value or "").startswith("color") for name, value in attrs)
        self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def test_tables_are_plain_html(answers: list[object]) -> None:
    tables = [one._repr_html_() for one in answers if hasattr(one, "_repr_html_")]
    assert len(tables) >= 7
    for table in tables:
        page = Page()
        page.feed(table)
        page.close()
        assert not page.open


def test_unresolved_channels_are_marked(farm: resin_farm.Farm, white: resin_farm.Measurement) -> None:
    fit = farm.fit(white, sigma_t_per_mm=(20.0, None), g=0.4)
    states = [channel.refined is not None and channel.refined.resolved_at_g for channel in fit.channels]
    assert not all(states), "σ_t of R and G lies below the given range"
    text = fit._repr_html_()
    assert text.count("border-left") == states.count(False)
    assert text.count("<td>unresolved</td>") + text.count("<td>outside</td>") == states.count(False)
    assert "<th>state</th>" in text and "state" not in str(fit).splitlines()[0]


def test_predictions_have_a_table() -> None:
    reflectances = tuple(
        resin_farm.Reflectance(channel, base, value, 0.0123)
        for channel, value in (("450", 0.5), ("550", 0.6))
        for base in ("black", "white")
    )
    colour = resin_farm.PrintColour("white", (81.234, -1.234, 3.456), (0.5, 0.01, 0.02), (200, 200, 190))
    prediction = resin_farm.Prediction(reflectances, (colour,))
    assert str(prediction).splitlines() == [
        "channel  over black        over white",
        "─" * 37,
        "450      0.500 ± 0.012  0.500 ± 0.012",
        "550      0.600 ± 0.012  0.600 ± 0.012",
        "over white: L* 81.23 ± 0.50, a* -1.234 ± 0.010, b* 3.456 ± 0.020",
    ]
    assert "background: rgb(200, 200, 190)" in prediction._repr_html_()
    assert repr(prediction) == "<Prediction 450, 550 over black, white>"
