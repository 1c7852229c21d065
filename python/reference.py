"""Writes docs/python-api.md, the reference of the package, from its docstrings. Fails if one is missing.

    python python/reference.py

Needs the installed package, since the options of the set-up are generated when it is built.
"""

import ast
import importlib.util
import pathlib
import re
import textwrap
from collections.abc import Iterator

PAGE = pathlib.Path(__file__).resolve().parent.parent / "docs" / "python-api.md"
WIDTH = 118

GROUPS = {
    "Farms and dictionaries": "Farm Dictionary Grid",
    "Measurements": "read_measurements Measurement MeasuredProfile Capture MeasurementWarning",
    "Fits": "FitOptions Measured MaterialFit ChannelFit Refined Medium Interval SecondLobe Candidate Curves Likelihood "
    "NuisanceEstimate SceneEstimate SourceShare ScaleCurve DistanceMap",
    "Planning": "Design SlabSet HalfWidths",
    "Profiles and prints": "Profile simulate predict Prediction Reflectance PrintColour",
    "Errors": "FarmError InvalidArgument NotFound Deleted NotInstalled Refused Unavailable",
}
ALIASES = "Path Materials Range Axis Slab Lab Array"
# Special methods that are part of the interface.
SPECIAL = ("__getitem__", "__iter__", "__contains__", "__str__")
HEAD = """# Python API

<!-- Written by python/reference.py from the docstrings. -->

All public names of the package `resin_farm`; [Python](python.md) is the guide. Lengths are in mm, coefficients in
1/mm, and profiles are radiance factors. Arrays are NumPy's, of 64-bit floats, with one value for each pixel unless a
shape is given; figures are matplotlib's. Methods that need an optional package raise an `ImportError` with the extra
that brings it.

In a prompt every object is a short line. `print` gives its table if it has one, and notebooks show the table.
"""

Definition = ast.ClassDef | ast.FunctionDef


def sources() -> Iterator[ast.Module]:
    spec = importlib.util.find_spec("resin_farm")
    assert spec is not None and spec.origin is not None
    package = pathlib.Path(spec.origin).parent
    for path in [*sorted(package.glob("*.py")), package / "_wire" / "set_up.py"]:
        yield ast.parse(path.read_text(encoding="utf-8"))


def wrapped(text: str, indent: str = "") -> str:
    lines = textwrap.wrap(
        " ".join(text.split()), WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
    for line in lines[1:]:
        assert not re.match(r"\s*([-+*#>|]|\d+\.)\s", line), f"a line begins like a list: {line}"
    return "\n".join(lines)


def documented(node: Definition, name: str) -> str:
    text = ast.get_docstring(node)
    assert text, f"{name} has no docstring"
    return text


def sections(text: str) -> tuple[str, dict[str, dict[str, str]]]:
    """A docstring's prose, and the entries of `Args`, `Returns` and `Raises`: texts by names."""
    prose, *rest = re.split(r"^(Args|Returns|Raises):\n", text, flags=re.MULTILINE)
    found = {}
    for title, body in zip(rest[::2], rest[1::2], strict=True):
        if title == "Returns":
            found[title] = {"": body}
            continue
        entries = re.split(r"^ {4}(?=\S)", body, flags=re.MULTILINE)
        pairs = (entry.partition(":") for entry in entries if entry.strip())
        found[title] = {name.strip(): text for name, _, text in pairs}
    return prose.strip(), found


def signature(node: ast.FunctionDef, name: str, drop_self: bool) -> str:
    arguments = [*node.args.args[drop_self:]]
    for argument in [*arguments, *node.args.kwonlyargs, *filter(None, [node.args.kwarg])]:
        assert argument.annotation is not None, f"{name}: {argument.arg} has no type"
    plain = ast.arguments(
        node.args.posonlyargs, arguments, node.args.vararg, node.args.kwonlyargs, node.args.kw_defaults,
        node.args.kwarg, node.args.defaults,
    )  # fmt: skip
    returns = "" if node.returns is None or node.name == "__init__" else f" -> {type_of(node.returns)}"
    parts = split_arguments(plain_types(ast.unparse(plain)))
    line = f"{name}({', '.join(parts)}){returns}"
    if len(line) <= 88:
        return line
    return f"{name}(\n" + "".join(f"    {part},\n" for part in parts) + f"){returns}"


def split_arguments(text: str) -> list[str]:
    """Splits at commas outside brackets, and sets defaults off by spaces."""
    parts, depth = [""], 0
    for letter in text:
        depth += (letter in "([{") - (letter in ")]}")
        if letter == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += " = " if letter == "=" and depth == 0 else letter
    return [part.strip() for part in parts if part]


def plain_types(text: str) -> str:
    """Types without the package's modules; quotes and spaces as a formatter sets them."""
    text = re.sub(r"\b(options|results|design|maps|profile|_connection)\.(?=[A-Z])", "", text)
    return re.sub(r"NDArray\[[\w.]+\]", "numpy.ndarray", text).replace("'", '"')


def type_of(node: ast.expr) -> str:
    return plain_types(ast.unparse(node))


def function(node: ast.FunctionDef, name: str, drop_self: bool = False) -> str:
    prose, found = sections(documented(node, name))
    names = [argument.arg for argument in [*node.args.args[drop_self:], *node.args.kwonlyargs]]
    names += [node.args.kwarg.arg] if node.args.kwarg else []
    described = found.get("Args", {})
    assert [*described] == names, f"{name}: described are {[*described]}, its arguments are {names}"
    parts = [f"```python\n{signature(node, name, drop_self)}\n```", *map(wrapped, prose.split("\n\n"))]
    if described:
        arguments = "\n".join(wrapped(f"- `{one}`: {text}", "  ") for one, text in described.items())
        parts.append(f"Arguments:\n\n{arguments}")
    if "Returns" in found:
        parts.append(wrapped(f"Returns {found['Returns']['']}"))
    if "Raises" in found:
        errors = "\n".join(wrapped(f"- `{one}` {text}", "  ") for one, text in found["Raises"].items())
        parts.append(f"Raises:\n\n{errors}")
    return "\n\n".join(parts)


def fields(node: ast.ClassDef) -> str:
    """The fields of a dataclass or a typed dictionary, with the strings that follow them."""
    lines = []
    for field, after in zip(node.body, [*node.body[1:], ast.Pass()], strict=True):
        if not isinstance(field, ast.AnnAssign) or not isinstance(field.target, ast.Name):
            continue
        if field.target.id.startswith("_"):
            continue
        name = f"{node.name}.{field.target.id}"
        match after:
            case ast.Expr(value=ast.Constant(value=str(text))):
                lines.append(wrapped(f"- `{field.target.id}: {type_of(field.annotation)}`: {text}", "  "))
            case _:
                raise AssertionError(f"{name} has no docstring")
    return "\n".join(lines)


def is_public(node: ast.stmt) -> bool:
    return isinstance(node, ast.FunctionDef) and (not node.name.startswith("_") or node.name in SPECIAL)


def decorators(node: ast.FunctionDef) -> list[str]:
    return [ast.unparse(one) for one in node.decorator_list]


def members(node: ast.ClassDef) -> Iterator[str]:
    methods = [one for one in node.body if isinstance(one, ast.FunctionDef) and is_public(one)]
    properties = [one for one in methods if {"property", "cached_property"} & {*decorators(one)}]
    if properties:
        lines = []
        for one in properties:
            assert one.returns is not None
            prose = " ".join(documented(one, f"{node.name}.{one.name}").split())
            lines.append(wrapped(f"- `{one.name}: {type_of(one.returns)}`: {prose}", "  "))
        yield "Properties:\n\n" + "\n".join(lines)
    for one in methods:
        if one in properties or (one.name == "__str__" and not ast.get_docstring(one)):
            continue
        name = f"{node.name}.{one.name}"
        title = name.replace("_", "\\_") if one.name in SPECIAL else name
        yield f"#### {title}\n\n" + function(one, name, drop_self="staticmethod" not in decorators(one))


def class_(node: ast.ClassDef, classes: dict[str, ast.ClassDef]) -> str:
    parts = [f"### {node.name}"]
    inits = [one for one in node.body if isinstance(one, ast.FunctionDef) and one.name == "__init__"]
    bases = [classes[base.id] for base in node.bases if isinstance(base, ast.Name) and base.id in classes]
    others = [ast.unparse(base) for base in node.bases if ast.unparse(base) not in ("TypedDict", "SetUp", "FarmAccess")]
    prose, _ = sections(documented(node, node.name))
    parts += map(wrapped, prose.split("\n\n"))
    parts += [f"Bases: {', '.join(f'`{base}`' for base in others)}."] if others else []
    if inits and ast.get_docstring(inits[0]):
        parts.append(function(inits[0], node.name, drop_self=True))
    hidden = [base for base in bases if base.name in ("SetUp", "FarmAccess")]
    listed = "\n".join(filter(None, map(fields, [node, *hidden])))
    parts += [f"Fields:\n\n{listed}"] if listed else []
    for one in [node, *hidden]:
        # Methods of a private base are those of the class.
        parts += members(ast.ClassDef(node.name, [], [], one.body, []))
    return "\n\n".join(parts)


def aliases(trees: list[ast.Module]) -> str:
    found = {}
    for tree in trees:
        for one, after in zip(tree.body, [*tree.body[1:], ast.Pass()], strict=True):
            target = (
                one.target
                if isinstance(one, ast.AnnAssign)
                else one.targets[0]
                if isinstance(one, ast.Assign)
                else None
            )
            if not isinstance(target, ast.Name) or target.id not in ALIASES.split():
                continue
            assert isinstance(one, ast.AnnAssign | ast.Assign) and one.value is not None
            text = after.value.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else None
            assert isinstance(text, str), f"{target.id} has no docstring"
            kind = str(one.value.value) if isinstance(one.value, ast.Constant) else type_of(one.value)
            found[target.id] = wrapped(f"- `{target.id}` is `{kind}`: {text}", "  ")
    return "\n".join(found[name] for name in ALIASES.split())


def page() -> str:
    """The page, of the package that is installed."""
    trees = list(sources())
    top = {one.name: one for tree in trees for one in tree.body if isinstance(one, ast.ClassDef | ast.FunctionDef)}
    classes = {name: one for name, one in top.items() if isinstance(one, ast.ClassDef)}
    parts = [HEAD.rstrip()]
    for title, names in GROUPS.items():
        parts.append(f"## {title}")
        for name in names.split():
            node = top[name]
            parts.append(
                class_(node, classes) if isinstance(node, ast.ClassDef) else f"### {name}\n\n" + function(node, name)
            )
    parts.append(f"## Types\n\nNames of types in the signatures above.\n\n{aliases(trees)}")
    return "\n\n".join(parts) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
