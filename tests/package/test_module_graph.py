"""No circle of files in either language, and that the script which looks for circles finds them."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("module_graph.py")
_spec = importlib.util.spec_from_file_location("module_graph", SCRIPT)
module_graph = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(module_graph)


def test_no_circle_of_files():
    done = subprocess.run([sys.executable, SCRIPT], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    for name in ("python/imucal: ", "rust/imucal-core: ", "rust/imucal: ", "rust/imucal-py: "):
        assert name in done.stdout


def written(folder, files):
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return folder


@pytest.mark.parametrize(
    "of_b",
    [
        "import p.q.b",
        "from p.q import b",
        "from p.q.b import f",
        "from .q.b import f",
        "from . import q\nfrom .q import b",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from p.q.b import f",
        "def work():\n    from p.q.b import f",
        "import importlib\nb = importlib.import_module('p.q.b')",
    ],
)
def test_every_import_of_python_counts(of_b, tmp_path):
    files = {"__init__.py": "", "a.py": of_b, "q/__init__.py": "", "q/b.py": "from ..a import g"}
    graph = module_graph.python_graph(written(tmp_path / "p", files))
    assert graph["p.a"] >= {"p.q.b"}
    assert module_graph.python_circles(graph) == [["p.a", "p.q.b"]]


def test_a_package_and_its_stub_are_one_file_and_may_not_be_used_by_what_they_import(tmp_path):
    files = {"__init__.py": "", "__init__.pyi": "from .a import f", "a.py": "from p import _core"}
    graph = module_graph.python_graph(written(tmp_path / "p", files))
    assert module_graph.python_circles(graph) == [["p", "p.a"]]
    (tmp_path / "p/a.py").write_text("import p._core as _core")
    assert module_graph.python_circles(module_graph.python_graph(tmp_path / "p")) == []


RUST = {"lib.rs": "mod a;\nmod b;\nmod c;", "b.rs": "use crate::a::f;", "c.rs": ""}


@pytest.mark.parametrize(
    "of_b",
    [
        "use crate::b::g;",
        "use super::b;",
        "use crate::{c, b::{self as other, g}};",
        "fn f() { crate::b::g() }",
        "fn f() { super::b::g() }",
        "pub(crate) use crate :: b\n  :: *;",
    ],
)
def test_every_path_of_rust_counts(of_b, tmp_path):
    graph = module_graph.rust_graph(written(tmp_path, {**RUST, "a.rs": of_b}))
    assert module_graph.rust_circles(graph) == [["crate::a", "crate::b"]]


@pytest.mark.parametrize(
    "of_b",
    [
        "// crate::b::g()",
        'const A: &str = "crate::b::g";',
        "use std::b::g;",
        "#[cfg(test)]\nmod tests {\n    use crate::b::g;\n    fn f() { if true { g() } }\n}",
        "#[cfg(test)]\nuse crate::b::g;",
        "#[cfg(test)]\nmod tests;",
    ],
)
def test_comments_strings_other_crates_and_tests_do_not_count(of_b, tmp_path):
    files = {**RUST, "a.rs": of_b, "a/tests.rs": "use crate::b::g;"}
    graph = module_graph.rust_graph(written(tmp_path, files))
    assert module_graph.rust_circles(graph) == []
    assert graph["crate::b"] == {"crate::a"}


def test_a_module_and_its_children_may_use_each_other_but_no_child_the_other(tmp_path):
    files = {
        "lib.rs": "mod a;",
        "a.rs": "mod x;\nmod y;\npub use x::f;",
        "a/x.rs": "use super::G;",
        "a/y.rs": "",
    }
    graph = module_graph.rust_graph(written(tmp_path, files))
    assert graph["crate::a"] == {"crate::a::x"}
    assert module_graph.rust_circles(graph) == []
    (tmp_path / "a/x.rs").write_text("use super::y::h;")
    (tmp_path / "a/y.rs").write_text("use super::f;")
    assert module_graph.rust_circles(module_graph.rust_graph(tmp_path)) == [["crate::a::x", "crate::a::y"]]


def test_a_circle_through_what_a_module_re_exports_counts(tmp_path):
    files = {
        "lib.rs": "mod a;\nmod b;",
        "a.rs": "mod x;\npub use x::f;",
        "a/x.rs": "use crate::b;",
        "b.rs": "use crate::a::f;",
    }
    graph = module_graph.rust_graph(written(tmp_path, files))
    assert module_graph.rust_circles(graph) == [["crate::a", "crate::a::x", "crate::b"]]


def test_the_way_round_a_circle_is_printed_once():
    graph = {"a": {"b"}, "b": {"c"}, "c": {"a", "b"}}
    assert list(module_graph.shortest_ways(graph, "abc")) == ["a > b > c > a", "b > c > b"]
