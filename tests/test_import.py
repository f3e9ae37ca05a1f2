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


def test_tensors_are_described_and_registered_with_torch_numpy_and_psutil_alone():
    others = (
        "open3d",
        "libusb_package",
        "kornia",
        "matplotlib",
        "pyarrow",
        "filelock",
        "typer",
        "rich",
        "laspy",
        "lzf",
    )
    code = f"""
import sys
sys.modules.update(dict.fromkeys({others}))  # an import of any of these fails from here
import torch, torchreg as tr
cloud = tr.Clouds(torch.rand(300, 3, generator=torch.Generator().manual_seed(0)))
near = tr.neighbors(cloud, radius=0.3, max_neighbors=30)
tr.fpfh(tr.estimate_normals(cloud, near), near)
tr.register(cloud, cloud)
"""
    assert "torchreg.registration.register" in modules_after(code)


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
