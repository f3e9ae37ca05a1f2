"""Importing the package loads torch and numpy; the heavy ones come where they are first used."""

import subprocess
import sys

import pytest

HEAVY = ("open3d", "kornia", "matplotlib", "typer", "rich", "laspy", "libusb_package", "hypothesis", "pytest")


def modules_after(code):
    """The names of all modules that a fresh interpreter has loaded after this code."""
    run = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys\nprint(*sys.modules)"], capture_output=True, text=True, check=True
    )
    return set(run.stdout.split())


def test_import_loads_nothing_heavy():
    loaded = modules_after("import torchreg")
    assert "torch" in loaded
    assert loaded.isdisjoint((*HEAVY, "torchreg.report"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["augment", "datasets", "learning", "nn", "reference", "synthetic"])
def test_submodules_come_on_first_use(name):
    assert f"torchreg.{name}" not in modules_after("import torchreg")
    assert f"torchreg.{name}" in modules_after(f"import torchreg; torchreg.{name}")


def test_every_public_name_is_there():
    import torchreg as tr

    assert len(set(tr.__all__)) == len(tr.__all__)
    assert all(hasattr(tr, name) for name in tr.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        tr.nothing  # noqa: B018
