"""The library of compiled kernels: turned off and on, refused where torch has to work, noticed where it is stale."""

import shutil
import subprocess
import sys
import warnings

import pytest
import torch
from torch._subclasses.fake_tensor import FakeTensorMode
from torch.autograd.forward_ad import dual_level, make_dual
from torch.fx.experimental.proxy_tensor import make_fx

import torchreg.native.library as library
from torchreg.native import call, native, native_kernels, native_library, torch_on_one_thread
from torchreg.native.fingerprint import fingerprint

built = pytest.mark.skipif(not native_library(), reason="no compiler was at hand when the package was installed")


@built
def test_kernels_work_on_plain_tensors_of_the_cpu_alone() -> None:
    assert native(torch.zeros(3), None)
    assert not native(torch.zeros(3, device="meta"))
    assert not native(torch.zeros(3), torch.zeros(3, device="meta"))


@built
def test_kernels_leave_to_torch_what_is_followed() -> None:
    x = torch.zeros(3)
    seen = []

    def ask(x: torch.Tensor) -> torch.Tensor:
        seen.append(native(x))
        return x + 1

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.jit.trace(ask, x, check_trace=False)
        with dual_level():
            ask(make_dual(x, torch.ones(3)))
    make_fx(ask)(x)
    with FakeTensorMode(allow_non_fake_inputs=True):
        ask(x)
    assert seen == [False] * 4
    assert native(x)
    assert not native(torch._neg_view(x))
    assert not native(x.to_sparse())


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
    with pytest.raises(RuntimeError, match="contiguous tensors on the CPU, got one on cpu, strides"):
        call("tree_boxes", torch.zeros(4, 4).t())


@built
def test_tensors_of_other_devices_are_refused() -> None:
    with pytest.raises(RuntimeError, match="on the CPU, got one on meta"):
        call("tree_boxes", torch.zeros(4, device="meta"))


@built
@pytest.mark.parametrize("threads", [1, 4])
def test_a_request_for_too_much_memory_is_an_error_of_python(threads) -> None:
    rows = torch.zeros(1024, 8)
    width = 2**55  # a thread asks for 64 times as many bytes
    with torch_on_one_thread(threads), pytest.raises(MemoryError, match="feature_shadows_f32"):
        call("feature_shadows_f32", rows, None, None, len(rows), width, 8, None, None)


@built
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits the memory of a process as Linux does")
def test_where_no_threads_can_be_made_one_does_the_work() -> None:
    program = """
import resource, torch
import torchreg as tr
from torchreg.native import torch_on_one_thread
cloud = tr.Clouds(points=torch.rand(30_000, 3, generator=torch.Generator().manual_seed(0)))
expected = tr.neighbors(cloud, 0.1, 5)
pages = int(open("/proc/self/statm").read().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + 7 * 2**20,) * 2)  # a stack takes 8 MiB
with torch_on_one_thread(16):
    found = tr.neighbors(cloud, 0.1, 5)
assert torch.equal(found.index, expected.index) and torch.equal(found.sq_distance, expected.sq_distance)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


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
@pytest.mark.skipif(shutil.which("objdump") is None, reason="no objdump to look into libraries with")
@pytest.mark.parametrize(("level", "register"), [("default", "%ymm"), ("avx2", "%zmm")])
def test_a_library_has_no_instructions_of_wider_processors(level, register) -> None:
    paths = list((library._FOLDER / "lib").glob(f"kernels_{level}.*"))
    for path in paths:
        code = subprocess.run(["objdump", "-d", path], capture_output=True, text=True, check=True).stdout
        assert register not in code


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


@built
def test_where_the_widest_library_cannot_be_loaded_the_next_is(tmp_path, monkeypatch):
    folder = tmp_path / "lib"
    folder.mkdir()
    (folder / "kernels_avx512.so").write_bytes(b"no library")
    shutil.copy(library._FOLDER / "lib" / native_library(), folder / "kernels_avx2.so")
    monkeypatch.setattr(library, "_FOLDER", tmp_path)
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: "AVX512")
    with pytest.warns(RuntimeWarning, match="not used"):
        found = library._library.__wrapped__()
    assert found._name == str(folder / "kernels_avx2.so")
