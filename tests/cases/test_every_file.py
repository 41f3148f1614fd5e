"""Every file of the folder of cases has a test in this folder."""

import ast
from pathlib import Path


def test_every_file_has_a_test(case_file):
    folder = case_file("README.md").parent
    used = set()
    for module in Path(__file__).parent.glob("test_*.py"):
        for node in ast.walk(ast.parse(module.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                used.add(node.value)
    # The programs of the folder are run by other tests, and Python may keep them compiled.
    files = [
        path.relative_to(folder) for path in folder.rglob("*") if path.is_file() and path.suffix != ".pyc"
    ]
    without = [
        str(path)
        for path in files
        if path.name not in ("README", "README.md") and not {str(path), *map(str, path.parents[:-1])} & used
    ]
    assert without == []
    assert len(files) > 60
