"""The library of compiled kernels: turned off and on, refused where torch has to work, noticed where it is stale."""

import pytest
import torch

import torchreg.native.library as library
from torchreg.native import call, native, native_kernels, native_library
from torchreg.native.fingerprint import fingerprint

built = pytest.mark.skipif(not native_library(), reason="no compiler was at hand when the package was installed")


@built
def test_kernels_work_on_plain_tensors_of_the_cpu_alone() -> None:
    assert native(torch.zeros(3), None)
    assert not native(torch.zeros(3, device="meta"))
    assert not native(torch.zeros(3), torch.zeros(3, device="meta"))


@built
def test_kernels_leave_transforms_of_functions_to_torch() -> None:
    seen = []

    def ask(x: torch.Tensor) -> torch.Tensor:
        seen.append(native(x))
        return x

    torch.func.vmap(ask)(torch.zeros(2, 3))
    assert seen == [False]


def test_kernels_are_turned_off_and_on() -> None:
    with native_kernels(False):
        assert not native(torch.zeros(3))
        with native_kernels():
            assert native(torch.zeros(3)) == bool(native_library())
        assert not native(torch.zeros(3))


@built
def test_strided_tensors_are_refused() -> None:
    with pytest.raises(RuntimeError, match="contiguous"):
        call("torchreg_sources", torch.zeros(4, 4).t())


def test_the_fingerprint_follows_every_source(tmp_path) -> None:
    assert fingerprint(tmp_path) == ""
    (tmp_path / "a.cpp").write_text("int a;\n")
    first = fingerprint(tmp_path)
    (tmp_path / "notes.txt").write_text("not a source")
    assert fingerprint(tmp_path) == first
    (tmp_path / "b.hpp").write_text("int b;\n")
    second = fingerprint(tmp_path)
    (tmp_path / "a.cpp").write_text("int c;\n")
    assert len({first, second, fingerprint(tmp_path)}) == 3


@built
def test_a_library_older_than_its_sources_is_not_used() -> None:
    path = library._FOLDER / "lib" / native_library()
    with pytest.warns(RuntimeWarning, match="older than their sources"):
        assert library._checked(path, "another") is None


def test_without_a_library_a_call_says_so(monkeypatch) -> None:
    monkeypatch.setattr(library, "_library", lambda: None)
    assert not native(torch.zeros(3))
    assert native_library() == ""
    with pytest.raises(RuntimeError, match="no library"):
        call("anything")
