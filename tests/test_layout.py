"""The house: every module imports by its path, no circle of imports, one name for one class."""

import ast
import importlib
import pkgutil
from collections import Counter
from pathlib import Path

import grimp
import pytest

import torchreg as tr
from torchreg.descriptors import DESCRIPTORS
from torchreg.solvers import SOLVERS

ROOT = Path(tr.__file__).parent
MODULES = sorted(
    module.name for module in pkgutil.walk_packages(tr.__path__, "torchreg.") if "__main__" not in module.name
)


def test_no_public_name_hides_a_module():
    for name in MODULES:
        module = importlib.import_module(name)
        parent, _, last = name.rpartition(".")
        assert getattr(importlib.import_module(parent), last) is module, name


def test_no_import_runs_in_a_circle_not_even_for_types():
    graph = grimp.build_graph("torchreg", exclude_type_checking_imports=False)
    left = {module: set(graph.find_modules_directly_imported_by(module)) for module in graph.modules}
    while left:
        free = [module for module, needs in left.items() if not needs & left.keys()]
        assert free, f"a circle among {sorted(left)[:8]}"
        for module in free:
            del left[module]


def test_no_two_classes_of_one_name():
    names = Counter(
        node.name
        for file in ROOT.rglob("*.py")
        for node in ast.parse(file.read_text()).body
        if isinstance(node, ast.ClassDef)
    )
    assert [name for name, count in names.items() if count > 1] == []


@pytest.mark.parametrize("name", ["ransac", "compatibility", "neighbors", "register", "verify", "icp"])
def test_no_package_bears_the_name_of_a_public_function(name):
    assert not (ROOT / name).exists()


def test_from_register_to_a_kernel_it_is_three_files():
    graph = grimp.build_graph("torchreg")
    first = graph.find_modules_directly_imported_by("torchreg.registration.register")
    second = {module for stage in first for module in graph.find_modules_directly_imported_by(stage)}
    records = {kind.__module__ for kind in (*DESCRIPTORS.values(), *SOLVERS.values())}  # which stages call
    kernels = ("preprocess.downsample", "neighborhoods.search", "preprocess.normals", "descriptors.fuse")
    more = ("matching.nearest", "verification.evidence", "verification.agreement", "solvers.poses", "refinement.icp")
    for kernel in (*kernels, *more):
        assert f"torchreg.{kernel}" in first | second, kernel
    assert {"torchreg.registration.describe", "torchreg.solvers.batch"} <= first
    assert all(module.startswith(("torchreg.descriptors.", "torchreg.solvers.")) for module in records)
