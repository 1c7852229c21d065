"""The package's modules form layers."""

import ast
import graphlib
import pathlib
from collections.abc import Iterator

import pytest

import resin_farm

PACKAGE = pathlib.Path(resin_farm.__file__).parent


def imported(source: str, modules: set[str]) -> Iterator[str]:
    """The modules that a module imports: at its top, within functions, or for types only."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0 and node.module, f"line {node.lineno}: imports are absolute"
            whole = node.module == "resin_farm"
            names = [f"resin_farm.{alias.name}" for alias in node.names] if whole else [node.module]
        else:
            continue
        for name in names:
            package, _, rest = name.partition(".")
            module = rest.partition(".")[0]
            if package == "resin_farm":
                # Other names of the package are defined by its __init__.
                yield module if module in modules else "__init__"


def check(sources: dict[str, str]) -> None:
    """
    Raises:
        CycleError: with the modules that import each other in a cycle.
    """
    modules = {*sources, "_wire"}
    graphlib.TopologicalSorter({name: imported(source, modules) for name, source in sources.items()}).prepare()


def test_modules_name_each_other_in_no_circle() -> None:
    """Imports within functions and under TYPE_CHECKING count."""
    sources = {path.stem: path.read_text(encoding="utf-8") for path in PACKAGE.glob("*.py")}
    assert {"results", "dictionary", "_access"} <= set(imported(sources["farm"] + sources["dictionary"], set(sources)))
    check(sources)


@pytest.mark.parametrize(
    "line",
    [
        "from resin_farm.a import x",
        "from resin_farm import a",
        "import resin_farm.a",
        "def f():\n    from resin_farm import a",
        "if TYPE_CHECKING:\n    from resin_farm.a import X",
    ],
)
def test_a_circle_is_found(line: str) -> None:
    """A cycle is found whatever the form of its imports."""
    with pytest.raises(graphlib.CycleError):
        check({"a": "from resin_farm.b import y", "b": line})
