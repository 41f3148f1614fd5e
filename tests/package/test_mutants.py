"""Deliberate errors of `make mutants`: all are in the copy of the sources, and one at a time is on."""

import random

from mutants.python_sites import PATTERN as IN_PYTHON, python_sites, with_switch
from mutants.rust_sites import PATTERN as IN_RUST, constants_of, rust_sites
from mutants.sites import applied
from mutants.trial import PythonTest, runs_of

AT_IMPORT = b'''LIMIT = 3.0


def above(a, least=2.0):
    """Docstring."""
    for value in a:
        if value > LIMIT + least:
            return True
    return False
'''
PYTHON = b'''"""Docstring."""

from __future__ import annotations


def value(a: int, b: float = 2.0) -> float:
    """An annotation, `1`, and text are no errors."""
    return (a + b * 3) if a > 0 and not b < 0.5 else -a
'''
RUST = b"""
const LIMIT: f64 = 2.0;

/// A comment: 1 + 1.
fn above(values: [f64; 3], k: usize) -> bool {
    assert!(k < 3);
    values[k] - 1.0 > LIMIT
}

#[cfg(test)]
mod tests {
    fn none() -> i32 { 1 + 1 }
}
"""


def test_each_python_error_changes_the_value_of_some_arguments():
    sites = dict(enumerate(python_sites("value.py", PYTHON, random.Random(1)), 1))
    assert sorted(site.before for site in sites.values()) == sorted(
        ["2.0", "+", "*", "3", "and", ">", "0", "not", "<", "0.5", "-"]
    )
    text = with_switch(applied(PYTHON, sites, IN_PYTHON))
    assert text.index("from __future__") < text.index("_imucal_mutant")
    body = text.replace("from imucal._mutant import is_on as _imucal_mutant\n", "")

    def values(number):
        names = {"_imucal_mutant": lambda own: own == number}
        exec(compile(body, "value.py", "exec"), names)
        cases = [(a, b) for a in (-1, 0, 1, 2) for b in (0.4, 0.5, 0.51, 7.0)]
        return [names["value"](*case) for case in cases] + [names["value"](1)]

    without = {}
    exec(compile(PYTHON, "value.py", "exec"), without)
    assert values(0)[-1] == without["value"](1) == 7.0
    assert all(values(number) != values(0) for number in sites)


def test_functions_of_a_module_reach_the_errors_that_its_import_evaluates():
    sites = dict(enumerate(python_sites("above.py", AT_IMPORT, random.Random(1)), 1))
    at_import = [number for number, site in sites.items() if site.at_import]
    assert [sites[number].before for number in at_import] == ["3.0", "2.0"]
    text = with_switch(applied(AT_IMPORT, sites, IN_PYTHON), at_import)
    reached = set()
    names = {"_imucal_mutant": reached.add}
    exec(compile(text.replace("from imucal._mutant import", "# from"), "above.py", "exec"), names)
    assert reached == set(at_import)
    reached.clear()
    assert names["above"]([]) is False
    assert set(at_import) <= reached < set(sites)


def test_cheap_tests_that_reach_an_error_run_first_and_no_others_than_those_of_their_files():
    tests = [
        PythonTest("tests/a.py::slow", 30.0, [1], False),
        PythonTest("tests/a.py::fast", 1.0, [1, 2], False),
        PythonTest("tests/a.py::near", 0.5, [2], False),
        PythonTest("tests/b.py::other", 0.1, [2], False),
        PythonTest("tests/a.py::endless", 1000.0, [1], False),
    ]
    assert runs_of(1, tests) == [(["tests/a.py::fast"], 1.0), (["tests/a.py::slow"], 30.0)]
    assert runs_of(1, tests[:4]) == [
        (["tests/a.py::fast"], 1.0),
        (["tests/a.py::slow", "tests/a.py::near"], 30.5),
    ]
    assert runs_of(3, tests) == []


def test_rust_errors_stand_only_where_code_runs():
    sites = rust_sites("above.rs", RUST, constants_of(RUST), random.Random(1))
    assert sorted((site.before, site.after) for site in sites if site.before != ">") == [
        ("-", "+"),
        ("1.0", "1.05"),
        ("LIMIT", "LIMIT * 1.05"),
    ]
    numbered = dict(enumerate(sites, 1))
    text = applied(RUST, numbered, IN_RUST)
    for number, site in numbered.items():
        assert f"is_on({number})" in text and f"/*{number}*/)" in text, site
    assert text.endswith(RUST.decode().partition("#[cfg(test)]")[2])
    # The difference stands in the changed and in the present comparison, each time changed and as it is.
    assert text.count("values[k]") == 4


def test_without_errors_the_text_is_unchanged():
    assert applied(RUST, {}, IN_RUST) == RUST.decode()
