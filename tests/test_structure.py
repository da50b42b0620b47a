"""The shape of the sources: no import circle, nothing too long, no assert or print in a library."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LIBRARY = ("mixer_torch", "scorers", "train")
FOLDERS = (*LIBRARY, "configs", "benchmarks", "tests")

LONGEST_FUNCTION = 60
LONGEST_FILE = 400
MOST_ARGUMENTS = 10

# What is still to be mended; whoever mends a case takes it off the list.
LONG_FUNCTIONS_TO_MEND: set[str] = set()
LONG_FILES_TO_MEND: set[str] = set()
CONSTRUCTORS_TO_MEND: set[str] = set()


def sources(folders=FOLDERS) -> list[Path]:
    """Every Python file once: `mixer_torch/scorers` and the like are links to folders beside it."""
    return sorted(
        file
        for folder in folders
        for file in (ROOT / folder).rglob("*.py")
        if not any(parent.is_symlink() for parent in file.parents)
    )


def parse(file: Path) -> ast.Module:
    return ast.parse(file.read_text(encoding="utf-8"), str(file))


def short(file: Path) -> str:
    return str(file.relative_to(ROOT))


def module_name(file: Path) -> str:
    """`mixer_torch.scorers.iou` for scorers/iou.py; helpers of the tests have bare names."""
    parts = list(file.relative_to(ROOT).with_suffix("").parts)
    if parts[0] == "tests":
        return parts[-1] if parts[-1] != "conftest" else ".".join(parts)
    parts = parts if parts[0] == "mixer_torch" else ["mixer_torch", *parts]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(tree: ast.Module, known: set[str]) -> Iterator[str]:
    """Modules of the project that a file names in an import, wherever in the file it stands.

    Imports inside functions and under `TYPE_CHECKING` count. `from package import name` is an edge
    to `package.name` where that is a module, otherwise to the package's `__init__`.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        elif isinstance(node, ast.ImportFrom) and node.module in known:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in known else node.module


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Strongly connected components of more than one file, or of one that imports itself."""
    order, index, low, stack, found = iter(range(len(graph))), {}, {}, [], []

    def visit(name: str) -> None:
        index[name] = low[name] = next(order)
        stack.append(name)
        for other in sorted(graph[name]):
            if other not in index:
                visit(other)
            if other in stack:
                low[name] = min(low[name], low[other])
        if low[name] == index[name]:
            start = stack.index(name)
            component = stack[start:]
            del stack[start:]
            if len(component) > 1 or name in graph[name]:
                found.append(sorted(component))

    for name in graph:
        if name not in index:
            visit(name)
    return found


@pytest.mark.parametrize(
    ("graph", "expected"),
    [
        ({"a": {"b"}, "b": {"c"}, "c": set()}, []),
        ({"a": {"b"}, "b": {"c"}, "c": {"b"}}, [["b", "c"]]),
        ({"a": {"a"}}, [["a"]]),
        ({"a": {"b", "c"}, "b": {"d"}, "c": {"d"}, "d": {"a"}}, [["a", "b", "c", "d"]]),
    ],
)
def test_circles_are_found(graph, expected):
    assert circles(graph) == expected


def test_imports_are_found_wherever_they_stand():
    program = """
import p.a
from p import b, name
def inside():
    from p.c import thing
if TYPE_CHECKING:
    import p.d
import os
"""
    known = {"p", "p.a", "p.b", "p.c", "p.d"}
    assert sorted(imports(ast.parse(program), known)) == sorted(known)


def test_no_import_circle():
    files = {module_name(file): file for file in sources()}
    graph = {name: set(imports(parse(file), set(files))) for name, file in files.items()}
    assert len(files) == len(sources()), "two files of one name"
    assert circles(graph) == []


def functions() -> Iterator[tuple[str, int]]:
    """Every function with its number of lines, decorators and docstring included."""
    for file in sources():
        for node in ast.walk(parse(file)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                first = min([node.lineno, *(item.lineno for item in node.decorator_list)])
                yield f"{short(file)}:{node.name}", node.end_lineno - first + 1


def test_no_function_is_too_long():
    long = {name for name, lines in functions() if lines > LONGEST_FUNCTION}
    assert long == LONG_FUNCTIONS_TO_MEND


def test_no_file_is_too_long():
    lengths = {short(file): len(file.read_text().splitlines()) for file in sources()}
    assert {name for name, lines in lengths.items() if lines > LONGEST_FILE} == LONG_FILES_TO_MEND


def constructors() -> Iterator[tuple[str, int]]:
    """Every `__init__` with its number of arguments beside `self`; dataclasses write none."""
    for file in sources():
        for cls in ast.walk(parse(file)):
            for node in cls.body if isinstance(cls, ast.ClassDef) else ():
                if isinstance(node, ast.FunctionDef) and node.name == "__init__":
                    given = node.args
                    arguments = [*given.posonlyargs, *given.args, *given.kwonlyargs]
                    yield f"{short(file)}:{cls.name}", len(arguments) - 1


def test_no_constructor_has_too_many_arguments():
    many = {name for name, count in constructors() if count > MOST_ARGUMENTS}
    assert many == CONSTRUCTORS_TO_MEND


def test_the_library_does_not_print_or_assert():
    found = []
    for file in sources(LIBRARY):
        if file.name == "cli.py":  # commands print: that is what they are for
            continue
        for node in ast.walk(parse(file)):
            prints = isinstance(node, ast.Call) and ast.unparse(node.func) == "print"
            if prints or isinstance(node, ast.Assert):
                found.append(f"{short(file)}:{node.lineno}")
    assert found == []
