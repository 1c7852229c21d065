"""Predictions of prints of a measured medium."""

import json
import pathlib

import jsonschema
import pytest

import resin_farm
from conftest import CHECKOUT, WHITE


@pytest.fixture(scope="module")
def media(farm: resin_farm.Farm, tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("media")
    farm.measure(WHITE, "grid", mu=1.0, output=folder)
    return folder


def test_prints_are_brighter_over_white(media: pathlib.Path) -> None:
    """A camera's red, green and blue have reflectances and no colours."""
    found = resin_farm.predict(media, ["white:1"], over=["black", 0.9], geometry="45:0", roughness=0)
    for channel in "RGB":
        assert 0.3 < found.radiance_factor(channel, "black") < found.radiance_factor(channel, "0.9") < 1
    assert all(r.std_error > 0 for r in found.reflectances)
    assert found.colours == ()
    with pytest.raises(KeyError, match="R over white"):
        found.radiance_factor("R", "white")


def test_slabs_are_texts_or_mixtures(media: pathlib.Path) -> None:
    """A mixture of one material is the material; farmctl's refusals are raised."""
    options = {"over": [0.5], "geometry": "d:8", "roughness": 0}
    text, mixture = (
        resin_farm.predict(media, [slab], **options)  # type: ignore[arg-type]
        for slab in ("white:0.5", ({"white": 1.0}, 0.5))
    )
    assert text == mixture
    with pytest.raises(resin_farm.FarmError, match="cyan"):
        resin_farm.predict(media, [("cyan", 0.5)])


def test_media_follow_their_schema(media: pathlib.Path) -> None:
    """The schema also refuses what is not a media file."""
    schema = json.loads((CHECKOUT / "docs/media.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    content = json.loads((media / "media.json").read_text())
    validator.validate(content)
    assert content["materials"][0]["channels"][0]["shared"]
    content["materials"][0]["channels"][0]["sigma_t_per_mm"] = -1
    assert [error.json_path for error in validator.iter_errors(content)] == [
        "$.materials[0].channels[0].sigma_t_per_mm"
    ]
