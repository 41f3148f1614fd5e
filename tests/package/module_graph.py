"""Which file of the project uses which, in both languages, and where such uses form a circle.

    python tests/package/module_graph.py            the circles; exit code 1 if there are any
    python tests/package/module_graph.py --graph    each file, and the files that it uses

Python: every import counts, also those for type checkers, inside of functions, and in stubs.
Rust: `use` and paths in code count, tests do not; a name that a module re-exports leads to the module that it
comes from, too. A Rust module and its own children may use each other; files of Python may not.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path

Graph = dict[str, set[str]]
RUST_CRATES = ("rust/imucal-core", "rust/imucal", "rust/imucal-py")


def main(words: list[str], root: Path) -> int:
    graphs = {"python/imucal": python_graph(root / "python/imucal")}
    graphs |= {crate: rust_graph(root / crate / "src") for crate in RUST_CRATES}
    found = 0
    for name, graph in graphs.items():
        print(f"{name}: {len(graph)} files, {sum(map(len, graph.values()))} arrows")
        if "--graph" in words:
            print("\n".join(f"  {file} > {', '.join(sorted(graph[file])) or '-'}" for file in sorted(graph)))
        circles = python_circles(graph) if name.startswith("python") else rust_circles(graph)
        found += len(circles)
        for circle in circles:
            print(f"  a circle of {len(circle)} files; the shortest way round each file:")
            print("\n".join(f"    {line}" for line in shortest_ways(graph, circle)))
    return 1 if found else 0


# --- circles ---


def python_circles(graph: Graph) -> list[list[str]]:
    """Files that reach each other, each group once."""
    return [sorted(group) for group in _components(graph) if len(group) > 1 or _uses_itself(graph, group)]


def rust_circles(graph: Graph) -> list[list[str]]:
    """Files that reach each other; a module is left out of a group that is itself and its own children."""
    found: list[list[str]] = []
    for group in _components(graph):
        if len(group) == 1:
            continue
        top = min(group, key=lambda module: (module.count("::"), module))
        if all(module == top or module.startswith(f"{top}::") for module in group):
            rest = set(group) - {top}
            found += rust_circles({module: graph[module] & rest for module in rest})
        else:
            found.append(sorted(group))
    return found


def shortest_ways(graph: Graph, circle: Iterable[str]) -> Iterator[str]:
    """For each file of a circle the shortest way from it back to it, each way once."""
    inside, shown = set(circle), set()
    for start in sorted(inside):
        ways = [[start]]
        for way in ways:
            following = sorted(graph[way[-1]] & inside)
            if start in following:
                if frozenset(way) not in shown:
                    shown.add(frozenset(way))
                    yield " > ".join([*way, start])
                break
            known = {module for known_way in ways for module in known_way}
            ways += [[*way, module] for module in following if module not in known]


def _uses_itself(graph: Graph, group: list[str]) -> bool:
    return group[0] in graph[group[0]]


def _components(graph: Graph) -> list[list[str]]:
    """Strongly connected components (Tarjan), without recursion."""
    number: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []
    for start in sorted(graph):
        if start in number:
            continue
        work = [(start, iter(sorted(graph[start])))]
        number[start] = low[start] = len(number)
        stack.append(start)
        while work:
            node, following = work[-1]
            for after in following:
                if after not in number:
                    number[after] = low[after] = len(number)
                    stack.append(after)
                    work.append((after, iter(sorted(graph[after]))))
                    break
                if after in stack:
                    low[node] = min(low[node], number[after])
            else:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[node])
                if low[node] == number[node]:
                    at = stack.index(node)
                    found.append(stack[at:])
                    del stack[at:]
    return found


# --- Python ---


def python_graph(package: Path) -> Graph:
    """Modules of a package, and the modules that each imports; a stub counts as its module."""
    files = [path for path in sorted(package.rglob("*.py*")) if path.suffix in (".py", ".pyi")]
    names = {path: _python_name(path, package) for path in files}
    known = set(names.values())
    graph: Graph = {name: set() for name in known}
    for path, name in names.items():
        inside = name if path.stem == "__init__" else name.rpartition(".")[0]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            graph[name] |= {module for module in _imported(node, inside) if module in known} - {name}
    return graph


def _python_name(path: Path, package: Path) -> str:
    parts = [package.name, *path.relative_to(package).with_suffix("").parts]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _imported(node: ast.AST, inside: str) -> Iterator[str]:
    """Names of what may be modules: for `from a import b` both `a` and `a.b`."""
    if isinstance(node, ast.Import):
        yield from (name.name for name in node.names)
    elif isinstance(node, ast.ImportFrom):
        parts = inside.split(".")[: len(inside.split(".")) - node.level + 1] if node.level else []
        origin = ".".join([*parts, *([node.module] if node.module else [])])
        modules = [f"{origin}.{name.name}" for name in node.names]
        yield origin
        yield from modules
    elif (
        isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute | ast.Name)
        and (node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id) == "import_module"
        and node.args
        and isinstance(node.args[0], ast.Constant)
    ):
        yield str(node.args[0].value)


# --- Rust ---

CHILD = re.compile(r"\bmod\s+(\w+)\s*;")
USE = re.compile(r"\buse\s+([^;]+);")
PATH = re.compile(r"(?<![\w:])\$?(?:r#)?[A-Za-z_]\w*(?:\s*::\s*(?:r#)?[A-Za-z_]\w*)+")


def rust_graph(source: Path) -> Graph:
    """Modules of a crate, and the modules whose items each names; `crate` is lib.rs."""
    texts: dict[str, str] = {}
    left_out: set[str] = set()
    for path in sorted(source.rglob("*.rs")):
        module = _rust_name(path, source)
        texts[module], tests = _without_tests(_plain_rust(path.read_text(encoding="utf-8")))
        left_out |= {f"{module}::{name}" for name in tests}
    files = {
        module: text
        for module, text in texts.items()
        if not any(module == test or module.startswith(f"{test}::") for test in left_out)
    }
    bound = {module: dict(_bound(text, module, files)) for module, text in files.items()}
    graph: Graph = {module: set() for module in files}
    for module, text in files.items():
        uses = [path for match in USE.finditer(text) for path, _ in _use_paths(match[1])]
        inline = [
            re.sub(r"\s", "", match[0]).lstrip("$").split("::") for match in PATH.finditer(USE.sub("", text))
        ]
        for path in [*uses, *inline]:
            graph[module] |= _targets(path, module, bound)
        graph[module].discard(module)
    return graph


def _rust_name(path: Path, source: Path) -> str:
    parts = path.relative_to(source).with_suffix("").parts
    return "::".join(["crate", *(part for part in parts if part not in ("lib", "main"))])


def _plain_rust(text: str) -> str:
    """The code without comments, strings and characters."""
    pattern = r"//[^\n]*|/\*.*?\*/|b?r(#*)\".*?\"\1|b?\"(?:\\.|[^\"\\])*\"|b?'(?:\\.[^']*|[^'\\])'"
    text = re.sub(pattern, " ", text, flags=re.DOTALL)
    return re.sub(r"\bpub\s*\([^)]*\)", "pub", text)


def _without_tests(text: str) -> tuple[str, list[str]]:
    """The code without items for tests alone, and the names of the files that are such items."""
    tests = []
    while (mark := re.search(r"#\[cfg\((?:test|all\(test\b[^\]]*)\)\]", text)) is not None:
        end = mark.end()
        child = re.match(r"(?:\s|#\[[^\]]*\])*(?:pub\s+)?mod\s+(\w+)\s*;", text[end:])
        if child is not None:
            tests.append(child[1])
        first = re.search(r"[;{]", text[end:])
        assert first is not None
        end += first.end()
        depth = 1 if first[0] == "{" else 0
        while depth:
            depth += {"{": 1, "}": -1}.get(text[end], 0)
            end += 1
        text = text[: mark.start()] + text[end:]
    return text, tests


def _use_paths(tree: str, before: tuple[str, ...] = ()) -> Iterator[tuple[list[str], str]]:
    """The paths of a `use`, each with the name that it binds."""
    tree = tree.strip()
    head, brace, inner = tree.partition("{")
    if not brace:
        path, _, alias = tree.partition(" as ")
        parts = [*before, *(part.strip() for part in path.split("::") if part.strip())]
        parts = parts[:-1] if len(parts) > 1 and parts[-1] == "self" else parts
        yield parts, alias.strip() or parts[-1]
        return
    start = (*before, *(part.strip() for part in head.split("::") if part.strip()))
    depth, item = 0, ""
    for char in inner.strip().removesuffix("}") + ",":
        depth += {"{": 1, "}": -1}.get(char, 0)
        if char == "," and depth == 0:
            if item.strip():
                yield from _use_paths(item, start)
            item = ""
        else:
            item += char


def _bound(text: str, module: str, files: Mapping[str, str]) -> Iterator[tuple[str, list[str]]]:
    """Names in a module that stand for paths from the root: its children, and what it uses."""
    for match in CHILD.finditer(text):
        if f"{module}::{match[1]}" in files:
            yield match[1], [*module.split("::"), match[1]]
    for match in USE.finditer(text):
        for path, name in _use_paths(match[1]):
            absolute = _absolute(path, module, lambda name: name if f"{module}::{name}" in files else None)
            if absolute is not None and name not in ("*", "_"):
                yield name, absolute


def _absolute(path: list[str], module: str, child: Callable[[str], str | None]) -> list[str] | None:
    """The path from the root; None for one that leads to another crate or to an item of this file."""
    here = module.split("::")
    if path[0] == "crate":
        return path
    if path[0] == "self":
        return [*here, *path[1:]]
    if path[0] == "super":
        ups = next((k for k, part in enumerate(path) if part != "super"), len(path))
        return [*here[: len(here) - ups], *path[ups:]]
    return [*here, *path] if child(path[0]) else None


def _targets(path: list[str], module: str, bound: Mapping[str, Mapping[str, list[str]]]) -> set[str]:
    """The files that a path names: where it leads, and where the names on its way come from."""
    start = _absolute(path, module, lambda _: None)
    if start is None:
        known = bound[module].get(path[0])
        if known is None:
            return set()
        start = [*known, *path[1:]]
    found: set[str] = set()
    ways, seen = [start], set()
    while ways:
        way = ways.pop()
        if tuple(way) in seen:
            continue
        seen.add(tuple(way))
        length = next((n for n in range(len(way), 0, -1) if "::".join(way[:n]) in bound), 0)
        if length == 0:
            continue
        file = "::".join(way[:length])
        found.add(file)
        if length < len(way) and way[length] in bound[file] and file != module:
            ways.append([*bound[file][way[length]], *way[length + 1 :]])
    return found


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], Path(__file__).resolve().parents[2]))
