"""Kernels use the threads that torch was given, within the limits of a container; torch one while they work."""

import os
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch
from determinism import threads

from torchreg.geometry.numerics.threads import shared_out
from torchreg.native import kernel_threads, native, native_kernels, torch_on_one_thread
from torchreg.native.threads import quota

CORES = len(os.sched_getaffinity(0))


def test_kernels_take_what_torch_has_and_torch_takes_one():
    for number in (1, 2):
        with threads(number):
            outside = kernel_threads()
            assert outside == min(number, CORES)
            with torch_on_one_thread():
                assert torch.get_num_threads() == 1
                assert kernel_threads() == outside
            assert torch.get_num_threads() == number


def test_parts_share_the_threads():
    def seen(_):
        return torch.get_num_threads(), kernel_threads()

    with threads(2), torch_on_one_thread(8):
        assert shared_out(seen, range(3), 2) == [(1, 4)] * 3
        assert shared_out(seen, range(1), 4) == [(1, 8)]
        assert shared_out(seen, [], 4) == []
    assert torch.get_num_threads() >= 1


def test_other_threads_keep_theirs():
    with threads(2), ThreadPoolExecutor(1) as pool:
        before = pool.submit(torch.get_num_threads).result()
        with torch_on_one_thread():
            assert pool.submit(torch.get_num_threads).result() == before


def test_an_error_gives_the_threads_back():
    with threads(2):
        with pytest.raises(ZeroDivisionError), torch_on_one_thread():
            _ = 1 / 0
        assert torch.get_num_threads() == 2


@pytest.mark.parametrize(
    ("files", "expected"),
    [
        ({}, CORES),
        ({"cpu.max": "max 100000\n"}, CORES),
        ({"cpu.max": "100000 100000\n"}, 1),
        ({"cpu.max": "150000 100000\n"}, min(2, CORES)),
        ({"cpu.max": "1000 100000\n"}, 1),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, CORES),
        ({"cpu/cpu.cfs_quota_us": "50000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 1),
        ({"cpu.max": "nonsense\n"}, CORES),
    ],
)
def test_a_container_limits_them(tmp_path, files, expected):
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    assert quota(tmp_path) == expected


def test_parts_run_in_the_context_of_the_call():
    with native_kernels(False):
        assert shared_out(lambda _: native(torch.zeros(2)), range(2), 2) == [False, False]
