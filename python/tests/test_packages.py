"""The version bounds of the required packages are correct, and extras bring what optional features need."""

import ast
import importlib.metadata
import pathlib
import re
import sys
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from packaging.requirements import Requirement

import resin_farm
from conftest import WHITE


def test_the_bounds_of_protobuf_are_those_of_the_generated_modules() -> None:
    """The modules run from the version of protobuf that generated them to the end of the next major one."""
    made = pathlib.Path(resin_farm.__file__).parent / "_wire" / "model_pb2.py"
    version = re.search(r"Protobuf Python Version: (\d+)\.(\d+)\.(\d+)", made.read_text(encoding="utf-8"))
    assert version is not None
    major, minor, patch = (int(number) for number in version.groups())
    needs = [Requirement(line) for line in importlib.metadata.requires("resin-farm") or []]
    (protobuf,) = [need.specifier for need in needs if need.name == "protobuf"]
    assert protobuf.contains(f"{major}.{minor}.{patch}") and protobuf.contains(f"{major + 1}.99.0")
    assert not protobuf.contains(f"{major}.{minor - 1}.99") and not protobuf.contains(f"{major + 2}.0.0")


def extras() -> dict[str, set[str]]:
    """The names that each extra of the installed package brings; those of other extras as `[name]`."""
    about = importlib.metadata.metadata("resin-farm")
    found: dict[str, set[str]] = {extra: set() for extra in about.get_all("Provides-Extra") or []}
    for need in map(Requirement, importlib.metadata.requires("resin-farm") or []):
        for extra, names in found.items():
            if need.marker and need.marker.evaluate({"extra": extra}):
                names |= {f"[{one}]" for one in need.extras} or {need.name}
    return found


def test_all_is_the_union_of_the_extras() -> None:
    found = extras()
    union = found.pop("all")
    assert union in ({f"[{extra}]" for extra in found}, set().union(*found.values())), union


def imports() -> Iterator[str]:
    """The top-level packages that this package imports anywhere, and those that it requires for a feature."""
    for path in pathlib.Path(resin_farm.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match node:
                case ast.Import(names=names):
                    yield from (alias.name.partition(".")[0] for alias in names)
                case ast.ImportFrom(module=str(module)):
                    yield module.partition(".")[0]
                case ast.Call(func=ast.Attribute(attr="require"), args=[_, *packages]):
                    yield from (str(package.value) for package in packages if isinstance(package, ast.Constant))


def test_every_import_is_a_dependency() -> None:
    """Extras bring all imports beyond the standard library and the dependencies, and no more."""
    needs = [Requirement(line) for line in importlib.metadata.requires("resin-farm") or []]
    required = {need.name for need in needs if need.marker is None}
    provided = {module for module, names in importlib.metadata.packages_distributions().items() if required & {*names}}
    optional = {*imports()} - {*sys.stdlib_module_names} - provided - {"resin_farm", "google"}
    assert optional == set().union(*(names for extra, names in extras().items() if extra != "all"))


def test_programs_are_found_by_the_record_of_the_wheel(monkeypatch: pytest.MonkeyPatch, tmp_path: pathlib.Path) -> None:
    """Wherever the wheel lies, and whatever the path; a missing program is an OSError, and no invalid measurement."""
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "executable", str(tmp_path / "embedded"))
    assert resin_farm.read_measurements(WHITE)
    monkeypatch.setenv("FARM_PROGRAMS", str(tmp_path))
    with pytest.raises(OSError, match="farmctl is not there: looked in ") as missing:
        resin_farm.read_measurements(tmp_path / "any.csv")
    assert isinstance(missing.value, resin_farm.FarmError) and not isinstance(missing.value, ValueError)


PROFILE = resin_farm.MeasuredProfile("R", 0.5, [-1, 0, 1], [0.1, 0.2, 0.3])
GREY = resin_farm.Measurement("grey", [PROFILE])
SIMULATED = resin_farm.Profile(
    resin_farm.Medium(6, 0.9, 0), 0.5, PROFILE.x_mm, {"R": PROFILE.values}, {"R": PROFILE.values}
)
FIT = resin_farm.MaterialFit("grey", ())
MEASURED = resin_farm.Measured((FIT,), 1.0, 0.0, False, None, None, "grid")
SCALE = resin_farm.ScaleCurve(np.ones(2), np.ones(2), 1.0, None, 0.0)
MAP = resin_farm.DistanceMap(
    "R", np.zeros(1), np.ones(1), np.zeros(1), np.ones((1, 1, 1)), (SIMULATED.medium,), (None,)
)


@pytest.mark.parametrize(
    ("extra", "package", "use"),
    [
        ("data", "pandas", GREY.to_pandas),
        ("data", "pandas", SIMULATED.to_pandas),
        ("data", "pandas", FIT.to_pandas),
        ("data", "pandas", MEASURED.to_pandas),
        ("data", "pandas", resin_farm.Design(SIMULATED.medium, "R", ()).to_pandas),
        ("data", "xarray", MEASURED.to_xarray),
        ("plot", "matplotlib", GREY.plot),
        ("plot", "matplotlib", SIMULATED.plot),
        ("plot", "matplotlib", SCALE.plot),
        ("plot", "matplotlib", MAP.plot),
    ],
)
def test_a_missing_package_is_named_with_its_extra(
    extra: str, package: str, use: Callable[[], object], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those of exports are tested with them."""
    assert package in extras()[extra]
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ImportError, match=rf"this needs {package}: pip install 'resin-farm\[{extra}\]'"):
        use()
